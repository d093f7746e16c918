// What goes on now, in the form in which a recorded run is drawn: one frame of it.

function makeLiveRun(data) {
  const n = data.tasks.length;
  return {
    rate: 1, frames: 1, robot: 0, label: "", colour: data.colours.smallest,
    most: data.most, warning: data.warning,
    targetNames: data.tasks, pairNames: data.pairs,
    poses: new Float32Array(7 * data.robots[0].paths.length),
    near: new Float32Array(8 * data.most).fill(NaN),
    targets: new Float32Array(3 * n).fill(NaN),
    reached: new Float32Array(3 * n).fill(NaN),
  };
}

function takeFrame(run, frame) {
  const flat = rows => rows.flat().map(x => (x === null ? NaN : x));
  run.poses.set(frame.poses);
  run.targets.set(flat(frame.targets));
  run.reached.set(flat(frame.reached));
  run.near.fill(NaN);
  run.near.set(flat(frame.near));
}

// The last seconds of distance and error, as the recorded page's time line has them.
const SHOWN = 20; // [s]

function makeChart(data, canvas) {
  const samples = [];
  const { target, smallest, violation } = data.colours;
  const context = canvas.getContext("2d");
  const top = distanceHeight(0.3, data.scaleUnit);
  const bottom = distanceHeight(-0.02, data.scaleUnit);

  function curve(name, colour, x, y) {
    context.beginPath();
    let down = false;
    for (const sample of samples) {
      const value = sample[name];
      if (value === null) down = false;
      else {
        context[down ? "lineTo" : "moveTo"](x(sample.time), y(value));
        down = true;
      }
    }
    context.strokeStyle = colour;
    context.lineWidth = 1.8;
    context.lineJoin = "round";
    context.stroke();
  }

  function draw() {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const ratio = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const [left, right, pad] = [58, 12, 8];
    const last = samples.length ? samples[samples.length - 1].time : 0;
    const x = time => left + (width - left - right) * (1 - (last - time) / SHOWN);
    const y = d => {
      const share = (distanceHeight(d, data.scaleUnit) - bottom) / (top - bottom);
      return height - pad - Math.min(Math.max(share, 0), 1) * (height - 2 * pad);
    };
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "right";
    context.textBaseline = "middle";
    const lines = height < 90 ? [0, data.floor, 0.05] : [0, data.floor, 0.02, 0.1];
    for (const d of lines) {
      context.strokeStyle = d === 0 ? violation : d === data.floor ? "#2a9d8f" : "#e3e8ec";
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(left, y(d));
      context.lineTo(width - right, y(d));
      context.stroke();
      context.fillStyle = "#5f6b76";
      context.fillText(millimetres(d), left - 6, y(d));
    }
    context.save();
    context.beginPath();
    context.rect(left, 0, width - left - right, height);
    context.clip();
    curve("error", target, x, y);
    curve("smallest", smallest, x, y);
    context.restore();
    context.textAlign = "left";
    for (const [name, colour, at] of [["smallest distance", smallest, 0], ["largest error", target, 112]]) {
      context.fillStyle = "rgb(255 255 255 / 80%)";
      context.fillRect(left + 4 + at, 1, name.length * 6, 13);
      context.fillStyle = colour;
      context.fillText(name, left + 6 + at, 8);
    }
  }
  return {
    draw,
    add({ time, smallest: d, error }) {
      const last = samples[samples.length - 1];
      if (last && time <= last.time) return;
      samples.push({ time, smallest: d, error });
      while (time - samples[0].time > SHOWN) samples.shift();
    },
  };
}
