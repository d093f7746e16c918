// The page: its texts, its clock, and what keys and buttons do.

// The numbers of frame after frame; see `packed_array` in packed_page.py.
function unpackArray(planes, frames) {
  const columns = planes.length / 4 / frames;
  const bytes = new Uint8Array(planes.length);
  let i = 0;
  for (let plane = 0; plane < 4; plane++)
    for (let column = 0; column < columns; column++)
      for (let frame = 0; frame < frames; frame++)
        bytes[4 * (frame * columns + column) + plane] = planes[i++];
  return new Float32Array(bytes.buffer);
}

const PLAY = "M4 2.5 14 8 4 13.5Z";
const PAUSE = "M4 3h3v10H4zM9 3h3v10H9z";

function icon(path) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("width", 16);
  draw(svg, "path", { d: path, fill: "currentColor" });
  return svg;
}

function writeCaption(data, runs) {
  const place = document.getElementById("crar-caption");
  place.querySelector("h1").textContent = data.title;
  place.querySelector("p").textContent = data.subtitle;
  const list = place.querySelector("ul");
  for (const run of runs) {
    const items = run.figures.map(({ name, value, bad }) => make(
      "li", {}, `${name} `, make("b", { className: bad ? "bad" : "" }, value)));
    const head = make("li", {}, swatch(run.colour), make("b", {}, run.label));
    list.append(...runs.length === 1 ? items : [make("ul", {}, head, ...items)]);
  }
}

function writeLegend(data, runs) {
  const list = document.querySelector("#crar-legend ul");
  const [far, middle, near] = data.nearness.colours;
  const { target, obstacle, violation } = data.colours;
  const warning = runs[0].warning;
  const at = data.nearness.steps.map(step => Math.round(1000 * step * warning));
  function entry(text, ...shapes) {
    const item = make("li", {});
    const svg = draw(item, "svg", { width: 34, height: 14, viewBox: "0 0 34 14" });
    for (const [name, attributes] of shapes) draw(svg, name, attributes);
    item.append(text);
    list.append(item);
  }
  const disc = (cx, r, attributes) => ["circle", { cx, cy: 7, r, ...attributes }];
  if (runs.some(run => run.targetNames.length)) {
    entry("target", disc(17, 5.5, { fill: target }));
    const line = { x1: 6, x2: 28, y1: 7, y2: 7, stroke: target, "stroke-width": 2 };
    entry("the point that should be there", ["line", line],
      disc(6, 3, { fill: "#fff", stroke: target }), disc(28, 5, { fill: target }));
  }
  if (data.robots.some(robot => robot.spheres)) {
    entry("obstacle that moves", disc(17, 6.5, { fill: obstacle, "fill-opacity": 0.75 }));
  }
  if (warning && runs.some(run => run.pairNames.length)) {
    entry(`links near each other: ${at.join(", ")} mm`, ...[far, middle, near].map(
      (fill, i) => disc(5 + 11 * i, 4 + i, { fill, "fill-opacity": 0.45 + 0.25 * i })));
  }
  if (runs.some(run => run.pairNames.length)) {
    entry(data.texts.inside, disc(17, 6.5, { fill: violation }));
  }
  for (const [name, colour] of Object.entries(data.spans)) {
    if (runs.some(run => run.spans[name].length)) {
      entry(name, ["rect", { x: 2, y: 4, width: 30, height: 6, fill: colour }]);
    }
  }
  const small = window.matchMedia("(max-width: 720px), (max-height: 560px)");
  const legend = document.getElementById("crar-legend");
  legend.open = !small.matches;
  small.addEventListener("change", () => { legend.open = !small.matches; });
}

function start() {
  const data = JSON.parse(document.getElementById("crar-data").textContent);
  const arrays = ["poses", "targets", "reached", "near"];
  const runs = data.runs.map(run => ({
    ...run, ...Object.fromEntries(
      arrays.map(name => [name, unpackArray(crarPacked[run[name]], run.frames)])),
  }));
  document.title = data.title;
  document.documentElement.style.setProperty("--violation", data.colours.violation);
  writeCaption(data, runs);
  writeLegend(data, runs);
  const element = name => document.getElementById(`crar-${name}`);
  const duration = Math.max(...runs.map(run => (run.frames - 1) / run.rate));
  const frame = 1 / runs[0].rate;
  const stage = makeStage(data, runs, element("stage"));
  const state = { time: 0, playing: false, speed: 1, held: false };

  function seek(time) {
    state.time = Math.min(Math.max(time, 0), duration);
    stage.show(state.time);
    timeline.move(state.time);
    const end = duration.toFixed(2);
    // As wide at the beginning as at the end.
    const now = state.time.toFixed(2).padStart(end.length, "\u2007");
    element("time").textContent = `${now} / ${end} s`;
  }
  function play(playing) {
    state.playing = playing && duration > 0;
    const button = element("play");
    button.replaceChildren(icon(state.playing ? PAUSE : PLAY));
    button.setAttribute("aria-label", state.playing ? "pause" : "play");
  }
  const timeline = makeTimeline(data, runs, element("timeline"), duration, {
    seek,
    grab: () => { state.held = true; },
    release: () => { state.held = false; },
  });
  function layOver(overlay) {
    stage.setOverlay(overlay);
    element("overlay").setAttribute("aria-pressed", String(stage.overlay));
  }
  function toggleScene() {
    const { gui } = viewer;
    const shown = gui.domElement.style.display !== "none";
    gui.domElement.style.display = shown ? "none" : "";
    if (!shown) gui.open();
    element("scene").setAttribute("aria-expanded", String(!shown));
  }
  function changeSpeed(steps) {
    const select = element("speed");
    const last = select.options.length - 1;
    select.selectedIndex = Math.min(Math.max(select.selectedIndex + steps, 0), last);
    state.speed = Number(select.value);
  }

  element("play").addEventListener("click", () => play(!state.playing));
  element("speed").addEventListener("change", () => changeSpeed(0));
  element("fit").addEventListener("click", () => stage.lookFrom());
  element("scene").addEventListener("click", toggleScene);
  element("overlay").addEventListener("click", () => layOver(!stage.overlay));
  element("overlay").hidden = runs.length < 2;
  const step = (event, sign) => {
    play(false);
    const wanted = state.time + sign * (event.shiftKey ? 1 : frame);
    // From one frame to the next, not from between them.
    seek(event.shiftKey ? wanted : Math.round(wanted / frame) * frame);
  };
  const keys = {
    Space: () => play(!state.playing),
    ArrowLeft: event => step(event, -1),
    ArrowRight: event => step(event, 1),
    ArrowUp: () => changeSpeed(1),
    ArrowDown: () => changeSpeed(-1),
    Home: () => seek(0),
    End: () => seek(duration),
    KeyR: () => stage.lookFrom(),
    KeyO: () => layOver(!stage.overlay),
    Digit1: () => stage.lookFrom(),
    Digit2: () => stage.lookFrom("Digit2"),
    Digit3: () => stage.lookFrom("Digit3"),
  };
  window.addEventListener("keydown", event => {
    const { code, target } = event;
    if (!keys[code] || event.ctrlKey || event.metaKey || event.altKey) return;
    // What is typed into Meshcat's panel, or chosen by keys, stays there.
    if (target.closest("input, textarea, select")) return;
    if (code === "Space" && target.closest("button, summary")) return;
    event.preventDefault();
    keys[code](event);
  });

  const resized = new ResizeObserver(() => {
    stage.resize();
    timeline.resize();
  });
  resized.observe(element("stage"));
  resized.observe(element("timeline"));
  stage.resize();
  timeline.resize();

  const wanted = /[#&]t=([0-9.]+)/.exec(location.hash);
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  layOver(stage.overlay);
  play(!wanted && !still);
  seek(wanted ? Number(wanted[1]) : 0);
  let before = performance.now();
  function tick(now) {
    const passed = Math.min((now - before) / 1000, 0.25);
    before = now;
    if (state.playing && !state.held) {
      const next = state.time + state.speed * passed;
      seek(next > duration ? 0 : next);
    }
    requestAnimationFrame(tick);
  }
  requestAnimationFrame(tick);
  // For scripts: what buttons and keys do, and where it stands.
  window.crar = { seek, play, layOver, state, stage, duration };
}

start();
