// The controls beside the scene, and the words about it.

const FARTHEST = 0.5; // that a slider moves a target [m]; a handle moves it farther

// A slider of a quantity, on a logarithmic scale if it cannot be 0.
function makeSlider(place, { id, name, range, unit, digits = 2, step, onMove }) {
  const [least, most] = range;
  const logarithmic = least > 0;
  const scale = logarithmic ? Math.log : x => x;
  const back = logarithmic ? Math.exp : x => x;
  const label = document.createElement("label");
  label.className = "slider";
  const input = document.createElement("input");
  Object.assign(input, {
    type: "range", id, min: scale(least), max: scale(most),
    step: step || (scale(most) - scale(least)) / 200,
  });
  const told = document.createElement("output");
  const text = document.createElement("span");
  text.textContent = name;
  label.append(text, input, told);
  place.append(label);
  const tell = value => {
    const tiny = value > 0 && value < 0.5 * 10 ** -digits;
    told.textContent = `${tiny ? value.toExponential(1) : value.toFixed(digits)} ${unit}`;
  };
  let touched = -Infinity;
  input.addEventListener("input", () => {
    touched = performance.now();
    const value = back(Number(input.value));
    tell(value);
    onMove(value);
  });
  return {
    // What it stands at, unless a person is moving it.
    show(value) {
      if (performance.now() - touched < 600) return;
      const at = String(scale(Math.min(Math.max(value, least), most)));
      if (Math.abs(Number(input.value) - Number(at)) > 1e-9) input.value = at;
      tell(value);
    },
    get value() { return back(Number(input.value)); },
  };
}

function makePanel(data, state, ask) {
  const element = name => document.getElementById(`live-${name}`);
  const option = (value, text) => Object.assign(
    document.createElement("option"), { value, textContent: text });

  const speed = makeSlider(element("speed"), {
    id: "live-speed-slider", name: "speed", range: data.speeds, unit: "×",
    onMove: value => ask({ do: "speed", value }),
  });
  element("task").append(...data.tasks.map((name, i) => option(i, name)));
  element("targets").hidden = !data.tasks.length;
  element("obstacle").hidden = !data.ball;
  if (data.ball)
    element("ball-speed").textContent = `drag the brown ball: ${data.ball.speed} m/s at most`;
  // Hands are what people want to move.
  const hand = names => Math.max(0, names.findIndex(name => /wrist|hand|tool/.test(name)));
  element("task").selectedIndex = hand(data.tasks);
  const axes = ["x", "y", "z"].map((name, axis) => makeSlider(element("axes"), {
    id: `live-${name}`, name, range: [-FARTHEST, FARTHEST], step: 0.005, digits: 3,
    unit: "m",
    onMove: value => {
      const task = Number(element("task").value);
      const offset = (state.wanted.get(task) || state.frame.offsets[task]).slice();
      offset[axis] = value;
      moveTarget(task, offset);
    },
  }));
  element("frame").append(...data.frames.map(({ name, label }) => option(name, label)));
  element("frame").selectedIndex = hand(data.frames.map(({ name }) => name));
  const force = makeSlider(element("force"), {
    id: "live-force-slider", name: "force", range: [10, data.strongest], unit: "N",
    digits: 0, onMove: () => {},
  });
  force.show(80);
  // Until a frame has it, what was asked for last is where the target is.
  function moveTarget(task, offset) {
    const value = offset.map(x => Math.min(Math.max(x, -2), 2));
    state.wanted.set(task, value);
    element("task").value = task;
    ask({ do: "offset", task, value });
  }

  const click = (name, request) => element(name).addEventListener(
    "click", () => ask(request()));
  click("pause", () => ({ do: state.frame.paused ? "resume" : "pause" }));
  click("step", () => ({ do: "step" }));
  click("stop", () => ({ do: "stop" }));
  click("motion", () => ({ do: "motion", value: !state.frame.motion }));
  click("home", () => {
    state.wanted.clear();
    return { do: "home" };
  });
  click("away", () => ({ do: "ball away" }));
  click("push", () => ({
    do: "push", frame: element("frame").value,
    value: element("direction").value.split(",").map(x => Number(x) * force.value),
  }));
  const keys = { Space: "pause", Period: "step", KeyM: "motion" };
  window.addEventListener("keydown", event => {
    const name = keys[event.code];
    if (!name || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest("select, button")) return;
    event.preventDefault();
    element(name).click();
  });

  function show(frame) {
    element("time").textContent = `${frame.time.toFixed(2)} s`;
    element("rate").textContent = frame.paused ? "paused"
      : `${frame.rate.toFixed(2)} × of ${frame.speed.toFixed(2)} ×`;
    element("rate").classList.toggle("bad", !frame.paused && frame.rate < 0.9 * frame.speed);
    const behind = frame.behind >= 0.1 ? `, ${frame.behind.toFixed(1)} s behind` : "";
    element("late").textContent = `${(1000 * frame.late).toFixed(0)} ms${behind}`;
    element("nearest").textContent = frame.smallest === null ? "–" : millimetres(frame.smallest);
    element("nearest").classList.toggle("bad", frame.smallest !== null && frame.smallest < data.floor);
    element("error").textContent = millimetres(frame.error || 0);
    const doing = [frame.status, frame.admitted].filter(
      word => word !== "tracking" && word !== "nominal");
    element("error").parentElement.title = doing.join(", ");
    element("pause").textContent = frame.paused ? "resume" : "pause";
    element("step").disabled = !frame.paused;
    element("motion").setAttribute("aria-pressed", String(frame.motion));
    element("motion").textContent = frame.motion ? "motion on" : "motion off";
    speed.show(frame.speed);
    if (data.tasks.length) {
      const offset = frame.offsets[Number(element("task").value)];
      axes.forEach((slider, i) => slider.show(offset[i]));
    }
    [element("promise").className, element("promise").textContent] = frame.promise;
    const rows = frame.near.slice(0, 6).map(([pair, d]) => {
      const row = document.createElement("li");
      const name = document.createElement("span");
      const value = document.createElement("b");
      name.textContent = data.pairs[pair];
      value.textContent = millimetres(d);
      if (d < 0) value.className = "bad";
      row.append(name, value);
      return row;
    });
    element("pairs").replaceChildren(...rows);
    notice(frame.notice);
  }

  function notice(text) {
    element("notice").hidden = !text;
    element("notice").textContent = text;
  }
  const moveBall = place => ask({
    do: "ball", value: place.map(x => Math.min(Math.max(x, -10), 10)) });
  return { show, notice, moveTarget, moveBall };
}
