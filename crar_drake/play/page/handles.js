// Targets and the ball are handles: dragged in the plane that the camera faces.

const REACH = { mouse: 14, pen: 16, touch: 30 }; // around a target [pixels]

function makeHandles(data, stage, run, element, state, panel) {
  // Meshcat's scene has y upwards, see `upright`.
  const standing = (x, y, z) => [x, -z, y];
  let held = null;

  const projection = () => toPixels(viewer.camera, viewer.scene, stage.views[0]);
  const at = event => {
    const box = element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  function hit(event) {
    const pixels = projection();
    const [x, y] = at(event);
    let [best, nearest] = [null, REACH[event.pointerType] || REACH.mouse];
    run.targetNames.forEach((_, task) => {
      const p = Array.from(run.targets.subarray(3 * task, 3 * task + 3));
      const place = pixels(p);
      if (!place) return;
      const away = Math.hypot(place[0] - x, place[1] - y);
      const { offsets } = state.frame;
      const move = place => panel.moveTarget(
        task, offsets[task].map((o, i) => o + place[i] - p[i]));
      if (away < nearest) [best, nearest] = [{ task, p, move }, away];
    });
    return best || hitBall(pixels, x, y);
  }
  function hitBall(pixels, x, y) {
    const p = state.frame.ball;
    const place = p && pixels(p);
    if (!place) return null;
    const size = data.ball.radius / Math.hypot(...pixelAt(p).across);
    const hits = Math.hypot(place[0] - x, place[1] - y) < size;
    return hits ? { task: null, p, move: panel.moveBall } : null;
  }
  // What a pixel across and one down are at a point of the scene [m].
  function pixelAt(p) {
    const pixels = projection();
    const e = viewer.camera.matrixWorld.elements;
    const across = standing(e[0], e[1], e[2]);
    const up = standing(e[4], e[5], e[6]);
    const moved = pixels(p.map((x, i) => x + 0.01 * across[i]));
    const size = 0.01 / Math.max(Math.abs(moved[0] - pixels(p)[0]), 1e-6);
    return { across: across.map(x => size * x), down: up.map(x => -size * x) };
  }

  // Before Meshcat's own listeners, which would turn the camera.
  element.addEventListener("pointerdown", event => {
    const found = event.button === 0 && state.frame ? hit(event) : null;
    if (!found) return;
    event.stopPropagation();
    event.preventDefault();
    held = {
      ...found, ...pixelAt(found.p), from: at(event), pointer: event.pointerId,
    };
    element.setPointerCapture(event.pointerId);
    element.classList.add("grabbing");
  }, true);
  element.addEventListener("pointermove", event => {
    if (!held) {
      element.classList.toggle("grab", Boolean(state.frame && hit(event)));
      return;
    }
    if (event.pointerId !== held.pointer) return;
    event.stopPropagation();
    const [x, y] = at(event);
    const [dx, dy] = [x - held.from[0], y - held.from[1]];
    held.move(held.p.map((x, i) => x + dx * held.across[i] + dy * held.down[i]));
  }, true);
  const release = event => {
    if (!held || event.pointerId !== held.pointer) return;
    held = null;
    element.classList.remove("grabbing");
  };
  element.addEventListener("pointerup", release, true);
  element.addEventListener("pointercancel", release, true);
  return { get held() { return held ? held.task : null; } };
}
