// What is drawn over the robots: targets, the lines to the points that should be
// there, and how near watched pairs are. It is seen through the links.

// Where a distance [m] stands on the scale, as in crar_drake/results/marks.py.
const distanceHeight = (d, unit) => Math.sign(d) * Math.log10(1 + Math.abs(d) / unit);

function millimetres(d) {
  const mm = 1000 * d;
  return `${mm.toFixed(Math.abs(mm) < 10 ? 1 : 0).replace("-", "−")} mm`;
}

const channels = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16));

// From 0 (as far as is shown) over 1/2 (the warning distance) to 1 (very near).
function closeness(data, d, warning) {
  const at = data.nearness.steps.map(s => distanceHeight(s * warning, data.scaleUnit));
  const height = distanceHeight(d, data.scaleUnit);
  if (height >= at[0]) return 0;
  if (height >= at[1]) return (at[0] - height) / (at[0] - at[1]) / 2;
  return Math.min(1, 0.5 + (at[1] - height) / (at[1] - at[2]) / 2);
}

function nearColour(data, share, d) {
  if (d < 0) return channels(data.colours.violation);
  const [far, middle, near] = data.nearness.colours.map(channels);
  const [a, b] = share < 0.5 ? [far, middle] : [middle, near];
  return a.map((c, i) => Math.round(mix(c, b[i], 2 * share - (share < 0.5 ? 0 : 1))));
}

// The frames around a time, and how far it is from one to the other.
function between(run, time) {
  const at = Math.min(Math.max(time * run.rate, 0), run.frames - 1);
  const from = Math.floor(at + 1e-6);
  return { from, to: Math.min(from + 1, run.frames - 1), share: Math.max(at - from, 0) };
}

// The near pairs at a time: pair, distance d, points a and b.
function nearAt(run, time) {
  const { from, to, share } = between(run, time);
  const entry = (frame, k) => {
    const i = 8 * (frame * run.most + k);
    return run.near.subarray(i, i + 8);
  };
  const later = new Map();
  for (let k = 0; k < run.most; k++) later.set(entry(to, k)[0], entry(to, k));
  const found = [];
  for (let k = 0; k < run.most; k++) {
    const now = entry(from, k);
    if (Number.isNaN(now[0])) break;
    const next = later.get(now[0]) || now;
    const v = Array.from(now, (x, i) => mix(x, next[i], share));
    found.push({ pair: now[0], d: v[1], a: v.slice(2, 5), b: v.slice(5, 8) });
  }
  return found.sort((one, other) => one.d - other.d);
}

function pointsAt(run, name, time) {
  const { from, to, share } = between(run, time);
  const n = run.targetNames.length;
  return Array.from({ length: n }, (_, k) => [0, 1, 2].map(i => mix(
    run[name][3 * (from * n + k) + i], run[name][3 * (to * n + k) + i], share)));
}

function drawMarks(data, context, view, pixels, time) {
  context.save();
  context.beginPath();
  context.rect(view.x, view.y, view.w, view.h);
  context.clip();
  const size = Math.min(Math.max(Math.min(view.w, view.h) / 500, 0.75), 1.3);
  const labels = [];
  for (const run of view.runs) {
    drawNear(data, context, view, run, pixels, time, size, labels);
    drawTargets(data, context, view, run, pixels, time, size);
  }
  drawLabels(context, view, labels, size);
  context.restore();
}

function disc(context, [x, y], radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
}

function segment(context, from, to) {
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
}

function drawTargets(data, context, view, run, pixels, time, size) {
  const reached = pointsAt(run, "reached", time).map(pixels);
  context.lineCap = "round";
  pointsAt(run, "targets", time).map(pixels).forEach((target, k) => {
    const point = reached[k];
    // NaN: there is no target at this time.
    if (!target || !point || Number.isNaN(target[0] + point[0])) return;
    for (const [colour, width] of [["rgb(255 255 255 / 75%)", 5], [data.colours.target, 2]]) {
      context.strokeStyle = colour;
      context.lineWidth = width * size;
      segment(context, target, point);
    }
    disc(context, target, 5.5 * size);
    context.fillStyle = data.colours.target;
    context.fill();
    context.lineWidth = 1.5 * size;
    context.strokeStyle = "#fff";
    context.stroke();
    disc(context, point, 2.6 * size);
    context.fillStyle = "#fff";
    context.fill();
    context.strokeStyle = view.runs.length > 1 ? run.colour : data.colours.target;
    context.stroke();
  });
}

const LABELLED = 3; // pairs of a run that are written on, if nearer than is warned of

function drawNear(data, context, view, run, pixels, time, size, labels) {
  const pairs = nearAt(run, time).reverse(); // the nearest is drawn last
  pairs.forEach(({ d, a, b }, i) => {
    const [from, to] = [pixels(a), pixels(b)];
    const share = closeness(data, d, run.warning);
    if (!from || !to || share === 0) return;
    const middle = [(from[0] + to[0]) / 2, (from[1] + to[1]) / 2];
    const rgb = nearColour(data, share, d).join(" ");
    const radius = (10 + 16 * share) * size;
    const nearer = pairs.slice(i + 1).some(pair => {
      const other = pixels(pair.a);
      return other && Math.hypot(other[0] - middle[0], other[1] - middle[1]) < radius;
    });
    if (!nearer) { // where several are near, one glow is enough to see through
      const glow = context.createRadialGradient(...middle, 0, ...middle, radius);
      glow.addColorStop(0, `rgb(${rgb} / ${0.6 * share})`);
      glow.addColorStop(0.6, `rgb(${rgb} / ${0.35 * share})`);
      glow.addColorStop(1, `rgb(${rgb} / 0)`);
      context.fillStyle = glow;
      disc(context, middle, radius);
      context.fill();
    }
    context.lineWidth = 2.5 * size;
    context.strokeStyle = `rgb(${rgb} / ${0.35 + 0.65 * share})`;
    segment(context, from, to);
    context.fillStyle = context.strokeStyle;
    for (const end of [from, to]) {
      disc(context, end, 2.2 * size);
      context.fill();
    }
    if (i >= pairs.length - LABELLED && share >= 0.5)
      labels.push({ at: middle, text: millimetres(d), rgb, run });
  });
}

// Beside what they belong to, away from the middle of the view and off each other; the
// upper one above, so that the lines to them do not cross.
function drawLabels(context, view, labels, size) {
  const taken = [];
  context.font = `600 ${Math.round(12.5 * Math.sqrt(size))}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  context.lineWidth = 1.2;
  for (const label of labels.sort((one, other) => one.at[1] - other.at[1])) {
    const { at: [x, y], text, rgb } = label;
    const w = context.measureText(text).width + 14 + (view.runs.length > 1 ? 12 : 0);
    const [h, away] = [20, 44 * size];
    const side = x < view.x + view.w / 2 ? -1 : 1;
    const box = { x: side < 0 ? x - away - w : x + away, y: y - away * 0.6 - h / 2, w, h };
    box.x = Math.min(Math.max(box.x, view.x + 4), view.x + view.w - w - 4);
    box.y = Math.min(Math.max(box.y, view.y + 4), view.y + view.h - h - 4);
    for (let tries = 0; tries < 12; tries++) {
      const hit = taken.find(o => Math.abs(o.y - box.y) < h + 3
        && box.x < o.x + o.w + 4 && o.x < box.x + w + 4);
      if (!hit) break;
      box.y = hit.y + h + 4;
    }
    taken.push(box);
    label.box = box;
    context.strokeStyle = `rgb(${rgb})`;
    segment(context, [side < 0 ? box.x + w : box.x, box.y + h / 2], [x, y]);
  }
  for (const { box, text, rgb, run } of labels) { // over all of the lines
    context.beginPath();
    context.roundRect(box.x, box.y, box.w, box.h, 6);
    context.fillStyle = "rgb(255 255 255 / 92%)";
    context.fill();
    context.strokeStyle = `rgb(${rgb})`;
    context.stroke();
    let start = box.x + 7;
    if (view.runs.length > 1) {
      disc(context, [start + 3, box.y + box.h / 2], 4);
      context.fillStyle = run.colour;
      context.fill();
      start += 12;
    }
    context.fillStyle = "#1f2933";
    context.fillText(text, start, box.y + box.h / 2 + 0.5);
  }
}
