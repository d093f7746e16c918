// The page: Meshcat's viewer, the newest frame, and requests.

let viewer;

// Requests go one at a time; of those that replace each other the last one counts.
function makeAsk(tell) {
  const waiting = new Map();
  let busy = false, count = 0;
  async function send() {
    if (busy) return;
    busy = true;
    while (waiting.size) {
      const [key, request] = waiting.entries().next().value;
      waiting.delete(key);
      try {
        const answer = await fetch("do", {
          method: "POST",
          headers: { "Content-Type": "application/json" },
          body: JSON.stringify(request),
        });
        if (!answer.ok) tell(await answer.text());
      } catch {
        tell("the simulation does not answer");
      }
    }
    busy = false;
  }
  return request => {
    const replaces = ["offset", "speed", "ball"].includes(request.do);
    waiting.set(replaces ? `${request.do} ${request.task}` : `once ${count++}`, request);
    send();
  };
}

function start(data) {
  const element = document.getElementById("crar-stage");
  document.documentElement.style.setProperty("--violation", data.colours.violation);
  viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
  viewer.connect(`ws://${location.hostname}:${data.meshcatPort}/`);
  const state = { frame: null, ended: false, frames: 0 };
  const run = makeLiveRun(data);
  const stage = makeStage(data, [run], element);
  const panel = makePanel(data, state, makeAsk(text => panel.notice(text)));
  const handles = makeHandles(data, stage, run, element, state, panel);

  function take(frame) {
    if (frame.ended) {
      state.ended = true;
      panel.notice(frame.ended);
      return;
    }
    state.frame = frame;
    state.frames += 1;
    takeFrame(run, frame);
    panel.show(frame);
    stage.show(0);
  }
  // The next frame is asked for when this one is drawn, so that none is an old one.
  async function look() {
    let number = 0;
    while (!state.ended) {
      try {
        const answer = await fetch(`live?after=${number}`);
        if (!answer.ok) throw new Error(answer.statusText);
        const told = await answer.json();
        number = told.number;
        if (told.frame) take(told.frame);
        await new Promise(requestAnimationFrame);
      } catch {
        panel.notice("no connection to the simulation");
        await new Promise(done => setTimeout(done, 1000));
      }
    }
  }
  look();
  new ResizeObserver(() => stage.resize()).observe(element);
  stage.resize();
  // For scripts: where it stands.
  window.crar = { state, stage, run, handles, viewer };
}

{
  const data = JSON.parse(document.getElementById("crar-data").textContent);
  const script = document.createElement("script");
  script.src = "meshcat.js";
  script.onload = () => start(data);
  script.onerror = () => {
    const notice = document.getElementById("live-notice");
    notice.hidden = false;
    notice.textContent = "Meshcat's viewer could not be loaded";
  };
  document.head.append(script);
}
