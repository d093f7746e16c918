// The time line below the picture: the smallest distance, the largest error of the
// targets, what the controller did, and a cursor that can be dragged.

const SVG = "http://www.w3.org/2000/svg";
const GUTTER = 46; // left of the lanes, for the scales [px]
const DISTANCE_TICKS = [-0.3, -0.1, -0.05, -0.02, -0.005, 0, 0.005, 0.02, 0.05, 0.1, 0.3];
const FAR = 0.3; // pairs farther apart are of no interest [m]

function draw(parent, name, attributes, text) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  parent.append(node);
  return node;
}

// The smallest of the steps 1, 2, 5, 10 ... that makes at most that many.
function niceStep(span, most) {
  const power = 10 ** Math.floor(Math.log10(span / most));
  return [1, 2, 5, 10].map(s => s * power).find(s => span / s <= most);
}

function curveAt(run, name, time) {
  const times = run.curve.time;
  let [low, high] = [0, times.length - 1];
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    if (times[middle] <= time + 1e-9) low = middle;
    else high = middle - 1;
  }
  return run.curve[name][low];
}

function largest(runs, name, usual) {
  const values = runs.flatMap(run => run.curve[name].filter(v => v !== null));
  return values.reduce((a, b) => Math.max(a, b), usual);
}

function distanceLane(data, runs) {
  const height = d => distanceHeight(d, data.scaleUnit);
  const values = runs.flatMap(run => run.curve.distance);
  const top = height(Math.min(FAR, Math.max(0.1, largest(runs, "distance", 0))));
  const bottom = height(Math.min(-0.001, 1.2 * values.reduce((a, b) => Math.min(a, b), 0)));
  return {
    name: "distance",
    titles: data.texts.distance,
    share: v => (height(Math.min(Math.max(v, -10), 10)) - bottom) / (top - bottom),
    ticks: DISTANCE_TICKS.map(v => [v, `${Math.round(1000 * v)}`.replace("-", "−")]),
    format: millimetres,
    weight: 1.8,
  };
}

function errorLane(data, runs) {
  const unit = runs.find(run => run.curve.unit).curve.unit;
  const factor = unit === "m" ? 1000 : 180 / Math.PI;
  const sign = unit === "m" ? " mm" : "°";
  const top = 1.1 * largest(runs, "error", 0.001);
  const step = niceStep(factor * top, 4);
  return {
    name: "error",
    titles: data.texts.error,
    share: v => v / top,
    ticks: [0, 1, 2, 3, 4].map(i => [i * step / factor, `${+(i * step).toPrecision(3)}`]),
    format: v => `${(factor * v).toFixed(factor * v < 10 ? 1 : 0)}${sign}`,
    weight: 1,
  };
}

function makeTimeline(data, runs, element, duration, on) {
  const svg = draw(element, "svg", {
    tabindex: 0,
    role: "slider",
    "aria-label": "time",
    "aria-valuemin": 0,
    "aria-valuemax": duration.toFixed(2),
  });
  const lanes = [];
  if (runs.some(run => run.curve.distance.length)) lanes.push(distanceLane(data, runs));
  if (runs.some(run => run.curve.error.length)) lanes.push(errorLane(data, runs));
  const striped = runs.filter(run => Object.values(run.spans).some(s => s.length));
  const single = runs.length === 1;
  let [left, right, time] = [GUTTER, 1, 0];
  let cursor = null;
  const narrow = () => right - left < 500;
  const x = t => left + (right - left) * (duration ? t / duration : 0);

  function drawLane(lane, top, bottom) {
    lane.y = v => bottom - (bottom - top) * lane.share(v);
    const box = { x: left, y: top, width: Math.max(right - left, 1), height: bottom - top };
    const clip = draw(svg, "clipPath", { id: `crar-${lane.name}` });
    draw(clip, "rect", box);
    if (lane.name === "distance") {
      const zero = lane.y(0);
      draw(svg, "rect", {
        ...box, y: zero, height: Math.max(bottom - zero, 0),
        fill: data.colours.violation, "fill-opacity": 0.13,
      });
    }
    let last = Infinity;
    for (const [value, text] of lane.ticks) {
      const y = lane.y(value);
      if (y < top - 1 || y > bottom + 1) continue;
      draw(svg, "line", { x1: left, x2: right, y1: y, y2: y, class: "grid" });
      if (last - y < 11) continue;
      draw(svg, "text", { x: left - 6, y: y + 4, "text-anchor": "end" }, text);
      last = y;
    }
    if (lane.name === "distance" && runs[0].warning) {
      const y = lane.y(runs[0].warning);
      draw(svg, "line", {
        x1: left, x2: right, y1: y, y2: y, stroke: data.nearness.colours[1],
        "stroke-dasharray": "3 3",
      });
    }
    for (const run of runs) {
      const values = run.curve[lane.name];
      let [path, pen] = ["", "M"];
      values.forEach((v, i) => {
        if (v === null) pen = "M"; // no targets: a gap
        else {
          path += `${pen}${x(run.curve.time[i]).toFixed(1)} ${lane.y(v).toFixed(1)}`;
          pen = "L";
        }
      });
      const colour = single
        ? data.colours[lane.name === "distance" ? "smallest" : "target"] : run.colour;
      draw(svg, "path", {
        d: path, class: "curve", stroke: colour, "clip-path": `url(#crar-${lane.name})`,
      });
    }
    const { reading } = Object.assign(lane, {
      reading: draw(svg, "text", { x: left + 2, y: top - 5, class: "reading" }),
    });
    draw(reading, "tspan", { class: "what" }, `${lane.titles[narrow() ? 1 : 0]}  `);
    lane.readings = runs.map(run => draw(reading, "tspan", {
      style: single ? "" : `fill: ${run.colour}`,
    }));
    lane.dots = runs.map(run => draw(svg, "circle", {
      r: 3.5, stroke: "#fff", fill: single ? data.colours.smallest : run.colour,
    }));
  }

  function drawStripes(y) {
    for (const run of striped) {
      for (const [name, spans] of Object.entries(run.spans)) for (const [from, to] of spans) {
        const stripe = draw(svg, "rect", {
          x: x(from), y, height: 5, width: Math.max(x(to) - x(from), 1),
          fill: data.spans[name],
        });
        draw(stripe, "title", {}, `${single ? "" : `${run.label}: `}${name}`);
      }
      if (!single) draw(svg, "rect", { x: left - 9, y, width: 6, height: 5, fill: run.colour });
      y += 7;
    }
  }

  // What does not fit in a line ends in dots.
  function shorten(lane, text) {
    const excess = lane.reading.getComputedTextLength() - (right - left);
    if (excess <= 0) return;
    const most = text.length - Math.ceil(excess / 5) - 1; // 5 px: a narrow letter
    lane.readings[0].textContent = `${text.slice(0, Math.max(most, 0)).trimEnd()}…`;
  }

  function move(now) {
    time = now;
    if (!cursor) return;
    const at = x(time);
    for (const line of [cursor.line, cursor.handle]) {
      line.setAttribute("transform", `translate(${at} 0)`);
    }
    for (const lane of lanes) runs.forEach((run, k) => {
      const value = run.curve[lane.name].length ? curveAt(run, lane.name, time) : null;
      const inside = value !== null && lane.share(value) <= 1.02;
      lane.dots[k].setAttribute("visibility", inside ? "visible" : "hidden");
      if (inside) {
        lane.dots[k].setAttribute("cx", at);
        lane.dots[k].setAttribute("cy", lane.y(value));
      }
      let text = value === null ? "–" : lane.format(value);
      if (!run.curve[lane.name].length) text = "";
      else if (!single)
        text = `${narrow() ? "" : `${run.label} `}${text}${k < runs.length - 1 ? "   " : ""}`;
      else if (lane.name === "distance") {
        const [nearest] = nearAt(run, time);
        if (nearest) text += ` · ${run.pairNames[nearest.pair]}`;
      }
      lane.readings[k].textContent = text;
      if (single && narrow()) shorten(lane, text);
    });
    svg.setAttribute("aria-valuenow", time.toFixed(2));
  }

  const timeline = { move };
  timeline.resize = () => {
    svg.replaceChildren();
    const [width, height] = [element.clientWidth - 12, element.clientHeight - 4];
    if (width <= GUTTER || height <= 0) return;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    right = width - 12;
    const axis = height - 16;
    const room = axis - 7 * striped.length - 18 * lanes.length - (striped.length ? 3 : 0);
    const weights = lanes.reduce((sum, lane) => sum + lane.weight, 0);
    let top = 0;
    for (const lane of lanes) {
      const bottom = top + 18 + room * lane.weight / weights;
      drawLane(lane, top + 18, bottom);
      top = bottom;
    }
    if (striped.length) drawStripes(top + 5);
    const step = duration ? niceStep(duration, Math.max(2, (right - left) / 70)) : 1;
    for (let t = 0; t <= duration + 1e-9; t += step) {
      draw(svg, "line", { x1: x(t), x2: x(t), y1: axis - 2, y2: axis + 2, stroke: "#9aa5b1" });
      draw(svg, "text", { x: x(t), y: height - 2, "text-anchor": "middle" },
        `${+t.toFixed(3)}${t + step > duration + 1e-9 ? " s" : ""}`);
    }
    cursor = {
      line: draw(svg, "line", { x1: 0, x2: 0, y1: 16, y2: axis, class: "cursor" }),
      handle: draw(svg, "circle", { cx: 0, cy: axis, r: 7, class: "handle" }),
    };
    for (const lane of lanes) svg.append(lane.reading, ...lane.dots); // over the cursor
    move(time);
  };

  // Dragged anywhere on the time line.
  let dragged = false;
  const seek = event => {
    const box = svg.getBoundingClientRect();
    const share = (event.clientX - box.left - left) / Math.max(right - left, 1);
    on.seek(Math.min(Math.max(share, 0), 1) * duration);
  };
  svg.addEventListener("pointerdown", event => {
    if (event.button !== 0) return;
    dragged = true;
    svg.setPointerCapture(event.pointerId);
    on.grab();
    seek(event);
    event.preventDefault();
  });
  svg.addEventListener("pointermove", event => { if (dragged) seek(event); });
  for (const end of ["pointerup", "pointercancel"]) {
    svg.addEventListener(end, () => {
      if (dragged) on.release();
      dragged = false;
    });
  }
  return timeline;
}
