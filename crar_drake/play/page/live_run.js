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
