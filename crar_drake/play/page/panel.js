// The controls beside the scene, and the words about it.

// A slider of a quantity that is not 0, on a logarithmic scale.
function makeSlider(place, { id, name, range, unit, digits, onMove }) {
  const [least, most] = range;
  const [min, max] = range.map(Math.log);
  const input = make("input", { type: "range", id, min, max, step: (max - min) / 200 });
  const told = make("output", {});
  place.append(make("label", { className: "slider" }, make("span", {}, name), input, told));
  const tell = value => { told.textContent = `${value.toFixed(digits)} ${unit}`; };
  let touched = -Infinity;
  input.addEventListener("input", () => {
    touched = performance.now();
    const value = Math.exp(Number(input.value));
    tell(value);
    onMove(value);
  });
  return {
    // What it stands at, unless a person is moving it.
    show(value) {
      if (performance.now() - touched < 600) return;
      const at = String(Math.log(Math.min(Math.max(value, least), most)));
      if (Math.abs(Number(input.value) - Number(at)) > 1e-9) input.value = at;
      tell(value);
    },
    get value() { return Math.exp(Number(input.value)); },
  };
}

function makePanel(data, state, ask) {
  const element = name => document.getElementById(`live-${name}`);
  const speed = makeSlider(element("speed"), {
    id: "live-speed-slider", name: "speed", range: data.speeds, unit: "×",
    digits: 2, onMove: value => ask({ do: "speed", value }),
  });
  element("targets").hidden = !data.tasks.length;
  element("obstacle").hidden = !data.ball;
  if (data.ball)
    element("ball-speed").textContent = `drag the brown ball: ${data.ball.speed} m/s at most`;
  // Hands are what people want to move.
  const hand = names => Math.max(0, names.findIndex(name => /wrist|hand|tool/.test(name)));
  element("frame").append(
    ...data.frames.map(({ name, label }) => make("option", { value: name }, label)));
  element("frame").selectedIndex = hand(data.frames.map(({ name }) => name));
  const force = makeSlider(element("force"), {
    id: "live-force-slider", name: "force", range: [10, data.strongest], unit: "N",
    digits: 0, onMove: () => {},
  });
  force.show(80);
  const within = (place, most) => place.map(x => Math.min(Math.max(x, -most), most));
  const moveTarget = (task, offset) =>
    ask({ do: "offset", task, value: within(offset, 2) });
  const moveBall = place => ask({ do: "ball", value: within(place, 10) });

  const click = (name, request) => element(name).addEventListener(
    "click", () => ask(request()));
  click("pause", () => ({ do: state.frame.paused ? "resume" : "pause" }));
  click("step", () => ({ do: "step" }));
  click("stop", () => ({ do: "stop" }));
  click("motion", () => ({ do: "motion", value: !state.frame.motion }));
  click("home", () => ({ do: "home" }));
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
    [element("promise").className, element("promise").textContent] = frame.promise;
    const rows = frame.near.slice(0, 6).map(([pair, d]) => make(
      "li", {}, make("span", {}, data.pairs[pair]),
      make("b", { className: d < 0 ? "bad" : "" }, millimetres(d))));
    element("pairs").replaceChildren(...rows);
    notice(frame.notice);
  }

  function notice(text) {
    element("notice").hidden = !text;
    element("notice").textContent = text;
  }
  return { show, notice, moveTarget, moveBall };
}
