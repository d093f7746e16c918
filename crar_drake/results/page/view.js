// The robots in Meshcat: posed, looked at and rendered, one view beside the other or
// the runs laid over each other in one.

const FIELD_OF_VIEW = 28; // vertical [deg]
const MARGIN = 1.06; // of the picture around what is to be seen
const HEADINGS = { // of the camera, as seen from the robot: azimuth, elevation [deg]
  Digit2: [0, 4],
  Digit3: [-90, 4],
};
const GHOST = 0.5; // opacity of the second run and later ones, laid over

// An element with properties, and what is in it.
function make(tag, properties, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

const swatch = colour => make("span", { className: "swatch", style: `background: ${colour}` });

// Meshcat's scene has z upwards, its camera is placed in a frame with y upwards.
const upright = ([x, y, z]) => [x, z, -y];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const mix = (a, b, share) => a + share * (b - a);

// The axes of a camera that looks at the robot from that side: across, up, towards it.
function axesFrom(azimuth, elevation) {
  const [a, e] = [azimuth * Math.PI / 180, elevation * Math.PI / 180];
  return {
    across: upright([-Math.sin(a), Math.cos(a), 0]),
    up: upright([-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)]),
    towards: upright([Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)]),
  };
}

// Where the camera has to be so that all points are just in the picture: each of its
// four sides is a plane that moves outwards until every point is behind it.
function fit(points, axes, aspect) {
  const tangent = Math.tan(FIELD_OF_VIEW * Math.PI / 360) / MARGIN;
  const sides = [[axes.across, tangent * aspect], [axes.up, tangent]].map(([axis, t]) => {
    let [more, less] = [-Infinity, -Infinity];
    for (const p of points) {
      const [x, depth] = [dot(p, axis), dot(p, axes.towards)];
      more = Math.max(more, x + t * depth);
      less = Math.max(less, -x + t * depth);
    }
    return { middle: (more - less) / 2, depth: (more + less) / (2 * t) };
  });
  const depths = points.map(p => dot(p, axes.towards));
  const middle = (Math.min(...depths) + Math.max(...depths)) / 2;
  const depth = Math.max(sides[0].depth, sides[1].depth, Math.max(...depths) + 0.1);
  const at = d => [0, 1, 2].map(i =>
    axes.across[i] * sides[0].middle + axes.up[i] * sides[1].middle
    + axes.towards[i] * d);
  return { position: at(depth), target: at(middle), distance: depth - middle };
}

function makeStage(data, runs, element) {
  const { scene, renderer } = viewer;
  const outline = [];
  for (let i = 0; i < data.outline.length; i += 3)
    outline.push(upright(data.outline.slice(i, i + 3)));
  const find = path => viewer.scene_tree.find(path.split("/").filter(Boolean)).object;
  const robots = data.robots.map(robot => ({
    group: find(robot.prefix), links: robot.paths.map(find),
  }));
  const surroundings = find(data.grid);
  const stage = { overlay: data.overlay && runs.length > 1, views: [], time: 0 };
  let axes = axesFrom(data.view.azimuth, data.view.elevation);
  let placedByUser = false;

  element.append(viewer.dom_element, viewer.gui.domElement);
  viewer.gui.domElement.style.display = "none";
  const canvas = make("canvas", { id: "crar-marks" });
  element.append(canvas);
  // Drawn by the processor: else Chromium may show older marks again once they are
  // cleared and none is drawn.
  const marks = canvas.getContext("2d", { willReadFrequently: true });

  viewer.controls.addEventListener("start", () => { placedByUser = true; });
  viewer.camera.fov = FIELD_OF_VIEW;
  viewer.camera.zoom = 1;

  // The columns of views in which the robots appear the largest.
  function arrange(width, height) {
    const n = stage.overlay ? 1 : runs.length;
    let best = null;
    for (let columns = 1; columns <= n; columns++) {
      const rows = Math.ceil(n / columns);
      const [w, h] = [width / columns, height / rows];
      const distance = fit(outline, axes, w / h).distance / h;
      if (best === null || distance < best.distance)
        best = { columns, w, h, distance };
    }
    stage.views = Array.from({ length: n }, (_, i) => ({
      x: (i % best.columns) * best.w,
      y: Math.floor(i / best.columns) * best.h,
      w: best.w,
      h: best.h,
      runs: stage.overlay ? runs : [runs[i]],
    }));
  }

  function placeCamera() {
    const { w, h } = stage.views[0];
    const { position, target, distance } = fit(outline, axes, w / h);
    viewer.camera.position.set(...position);
    viewer.camera.far = Math.max(100, 4 * distance);
    viewer.controls.target.set(...target);
  }

  function label() {
    element.querySelectorAll(".view-label").forEach(old => old.remove());
    if (runs.length < 2) return;
    for (const view of stage.views) {
      const lines = view.runs.map(run => make("div", {}, swatch(run.colour), run.label));
      const style = `left: ${view.x}px; top: ${view.y}px`;
      element.append(make("div", { className: "view-label", style }, ...lines));
    }
  }

  stage.resize = () => {
    const [width, height] = [element.clientWidth, element.clientHeight];
    if (!width || !height) return;
    arrange(width, height);
    viewer.set_3d_pane_size(width, height);
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    marks.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (!placedByUser) placeCamera();
    label();
    viewer.set_dirty();
  };
  stage.lookFrom = code => {
    const [azimuth, elevation] = HEADINGS[code]
      || [data.view.azimuth, data.view.elevation];
    axes = axesFrom(azimuth, elevation);
    placedByUser = false;
    stage.resize();
  };
  stage.setOverlay = overlay => {
    stage.overlay = overlay && runs.length > 1;
    stage.resize();
  };
  stage.show = time => {
    stage.time = time;
    viewer.set_dirty();
  };

  function pose(run) {
    const { links } = robots[run.robot];
    const { from, to, share } = between(run, stage.time);
    links.forEach((link, b) => {
      const [i, j] = [7 * (from * links.length + b), 7 * (to * links.length + b)];
      const p = [0, 1, 2].map(k => mix(run.poses[i + k], run.poses[j + k], share));
      link.position.set(...p);
      link.quaternion.fromArray(run.poses, i + 3);
      link.quaternion.slerp(link.quaternion.clone().fromArray(run.poses, j + 3), share);
    });
    for (const robot of robots) robot.group.visible = robot === robots[run.robot];
  }

  // Colours what is in a group, and gives what brings its own colours back.
  function tint(group, colour, opacity) {
    const before = new Map();
    group.traverse(object => {
      for (const material of [object.material].flat()) {
        if (!material || !material.color || before.has(material)) continue;
        const { transparent, opacity: usual } = material;
        before.set(material, { transparent, usual, color: material.color.clone() });
        const wanted = material.color.clone().set(colour);
        material.color.lerp(wanted, 0.75);
        material.transparent = transparent || opacity < 1;
        material.opacity = usual * opacity;
      }
    });
    return () => before.forEach(({ transparent, usual, color }, material) => {
      material.transparent = transparent;
      material.opacity = usual;
      material.color.copy(color);
    });
  }

  // The links that are inside others, in the frame that is the nearest in time.
  function tintPenetrating(run) {
    const { from, to, share } = between(run, stage.time);
    const frame = share < 0.5 ? from : to;
    const { links } = robots[run.robot];
    const restore = Object.entries(run.penetrating || {})
      .filter(([, spans]) => spans.some(([a, b]) => a <= frame && frame <= b))
      .map(([link]) => tint(links[link], data.colours.violation, 1));
    return () => restore.reverse().forEach(each => each());
  }

  viewer.render = () => {
    const { camera, controls } = viewer;
    const height = element.clientHeight;
    controls.update();
    renderer.autoClear = false;
    renderer.setScissorTest(false);
    renderer.clear();
    renderer.setScissorTest(true);
    marks.clearRect(0, 0, element.clientWidth, height);
    for (const view of stage.views) {
      const { x, y, w, h } = view;
      renderer.setViewport(x, height - y - h, w, h);
      renderer.setScissor(x, height - y - h, w, h);
      camera.aspect = w / h;
      camera.updateProjectionMatrix();
      const { background } = scene;
      view.runs.forEach((run, k) => {
        pose(run);
        scene.background = k ? null : background;
        surroundings.visible = !k;
        const restore = view.runs.length > 1
          ? tint(robots[run.robot].group, run.colour, k ? GHOST : 1) : () => {};
        const restoreLinks = tintPenetrating(run);
        renderer.render(scene, camera);
        restoreLinks();
        restore();
      });
      scene.background = background;
      surroundings.visible = true;
      drawMarks(data, marks, view, toPixels(camera, scene, view), stage.time);
    }
    viewer.needs_render = false;
  };
  return stage;
}

// What takes a point in the world to the pixels of a view; null behind the camera.
function toPixels(camera, scene, { x, y, w, h }) {
  const e = camera.projectionMatrix.clone()
    .multiply(camera.matrixWorldInverse).multiply(scene.matrixWorld).elements;
  return p => {
    const [u, v, , depth] = [0, 1, 2, 3].map(
      i => e[i] * p[0] + e[4 + i] * p[1] + e[8 + i] * p[2] + e[12 + i]);
    return depth > 0
      ? [x + (1 + u / depth) * w / 2, y + (1 - v / depth) * h / 2] : null;
  };
}
