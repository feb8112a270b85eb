// The replay: time, and what the reader does with it by mouse, touch and keys.

const CAMERAS = ["orbit", "above", "side", "follow"];
const STEPS = { ArrowLeft: -1, ArrowRight: 1 };
let playing = false, busy = false;
let before = 0; // ms, of the last frame

/** Draw the scene at the time of the replay; while one drawing is under way, the next waits for it. */
async function drawScene() {
  if (busy || !find("space").data) return;
  busy = true;
  let drawn;
  do {
    drawn = time;
    const solids = moving(), lines = plumbs();
    const change = Object.fromEntries(["x", "y", "z"].map((axis) => [axis, [solids[axis], lines[axis]]]));
    for (const name of ["i", "j", "k", "facecolor"]) change[name] = [solids[name], undefined];
    const layout = camera === "follow" ? { "scene.camera": preset("follow") } : {};
    await Plotly.update(find("space"), change, layout, [0, 1]);
  } while (drawn !== time && !playing);
  busy = false;
}

function tell() {
  const scrub = find("scrub"), text = (value, digits = 2) => value.toFixed(digits).replace("-0.00", "0.00");
  scrub.value = time;
  scrub.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds`);
  find("clock").textContent = `${time.toFixed(2)} / ${replay.stop.toFixed(2)} s`;
  const table = make("table");
  for (const run of replay.runs) {
    for (const vehicle of run.vehicles) {
      if (!isShown(run, vehicle)) continue;
      const [x, y, z, , , psi] = at(run, vehicle.pose, time), chip = make("i", { class: "chip" });
      chip.style.color = tone(vehicle.colour);
      const name = replay.runs.length > 1 ? `${data.runs[run.number].id.slice(0, 6)} ${vehicle.name}` : vehicle.name;
      const degrees = (((psi * 180) / Math.PI + 540) % 360 + 360) % 360 - 180;
      const cells = [`x ${text(x)}`, `y ${text(y)}`, `z ${text(z)} m`, `ψ ${degrees.toFixed(0)}°`];
      table.append(make("tr", {}, make("td", {}, chip, name), ...cells.map((cell) => make("td", {}, cell))));
    }
  }
  const flow = flowAt(time), lines = [table];
  const [run] = replay.runs;
  if (replay.runs.length === 1 && run.vehicles.length === 2) {
    const [a, b] = run.vehicles.map((vehicle) => at(run, vehicle.pose, time));
    const holds = run.object && time >= run.object.from && time <= run.object.to ? ", holding the object" : "";
    lines.push(make("div", {}, `distance ${text(Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]), 3)} m${holds}`));
  }
  if (flow && Math.hypot(...flow) > 0) lines.push(make("div", { style: "color: var(--current)" }, `⟶ current ${text(Math.hypot(...flow))} m/s`));
  find("readout").replaceChildren(...lines);
}

function setTime(t) {
  time = Math.min(replay.stop, Math.max(replay.start, t));
  tell();
  onSeek.forEach((call) => call(time));
  return drawScene();
}

function frame(stamp) {
  if (!playing) return;
  const elapsed = before ? (stamp - before) / 1000 : 0;
  before = stamp;
  setTime(time + elapsed * Number(find("speed").value));
  if (time >= replay.stop) setPlaying(false);
  else requestAnimationFrame(frame);
}

function setPlaying(wanted) {
  if (wanted === playing) return;
  if (wanted && time >= replay.stop) time = replay.start;
  playing = wanted;
  before = 0;
  find("play").setAttribute("aria-label", playing ? "Pause" : "Play");
  find("play").firstElementChild.textContent = playing ? "❚❚" : "▶";
  if (playing) requestAnimationFrame(frame);
  else setTime(time);
}

function setCamera(name) {
  if (!find("space").data) return undefined; // not drawn yet
  camera = name;
  offset = null;
  for (const button of document.querySelectorAll("[data-camera]")) button.setAttribute("aria-pressed", String(button.dataset.camera === name));
  find("whom").hidden = name !== "follow" || find("followed").options.length < 2;
  return Plotly.relayout(find("space"), { "scene.camera": preset(name) });
}

/** Where the scene has a vehicle: the middle of its side plates in the mesh that is drawn, in NED [m]; null if hidden. */
function drawnAt(run, name) {
  const mesh = find("space").data[0], vehicle = run.vehicles.find((other) => other.name === name);
  if (!isShown(run, vehicle)) return null;
  const middle = (values) => values.slice(vehicle.first + 8, vehicle.first + 24).reduce((sum, value) => sum + value / 16, 0);
  return [middle(mesh.y), middle(mesh.x), middle(mesh.z)];
}

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select, input[type=number], textarea")) return;
  if (event.key === " " && event.target.closest("button, summary, a")) return; // presses that
  if (event.key === " ") setPlaying(!playing);
  else if (event.key in STEPS) setTime(time + STEPS[event.key] * (event.shiftKey ? 1 : 0.1));
  else if (event.key === "Home") setTime(replay.start);
  else if (event.key === "End") setTime(replay.stop);
  else if (CAMERAS[Number(event.key) - 1]) setCamera(CAMERAS[Number(event.key) - 1]);
  else return;
  event.preventDefault();
}

function start() {
  find("replay").hidden = false;
  const scrub = find("scrub");
  [scrub.min, scrub.max] = [replay.start, replay.stop];
  replay.runs.forEach((run, i) => run.vehicles.forEach((vehicle, k) => {
    const label = replay.runs.length > 1 ? `${data.runs[run.number].id.slice(0, 6)} ${vehicle.name}` : vehicle.name;
    find("followed").append(make("option", { value: `${i} ${k}` }, label));
  }));
  const remarks = [];
  if (replay.scale > 1) remarks.push(`Vehicles are drawn ${replay.scale} times their size.`);
  if (replay.runs.some((run) => run.object)) remarks.push("The object is as long as the vehicles are apart, and drawn below them.");
  find("remarks").textContent = remarks.join(" ");
  tell();
  const modes = { displayModeBar: false, responsive: true, scrollZoom: true };
  const painted = new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve)));
  const ready = painted.then(() => Plotly.newPlot(find("space"), sceneTraces(), sceneLayout(), modes)).then((scene) => {
    scene.on("plotly_relayout", (change) => {
      const moved = change["scene.camera"];
      if (camera === "follow" && moved && !busy) {
        offset = Object.fromEntries(["x", "y", "z"].map((axis) => [axis, moved.eye[axis] - moved.center[axis]]));
      }
    });
  });
  redrawScene = () => {
    tell();
    if (!find("space").data) return;
    Plotly.react(find("space"), sceneTraces(), { ...sceneLayout(), scene: { ...sceneLayout().scene, camera: find("space").layout.scene.camera } }, modes);
  };
  darkness.addEventListener("change", redrawScene);
  seek = setTime;
  find("play").addEventListener("click", () => setPlaying(!playing));
  scrub.addEventListener("input", () => setTime(scrub.valueAsNumber));
  find("followed").addEventListener("change", () => setCamera("follow"));
  for (const button of document.querySelectorAll("[data-camera]")) button.addEventListener("click", () => setCamera(button.dataset.camera));
  document.addEventListener("keydown", onKey);
  return ready;
}

/** For scripts: run is the number of a run on the page, from 0; poses are [x, y, z, phi, theta, psi] in m and rad. */
const ready = replay ? start() : Promise.resolve();
window.orch = {
  ready,
  get time() { return time; },
  get playing() { return playing; },
  get window() { return [...span()]; },
  seek: (t) => setTime(t),
  play: () => setPlaying(true),
  pause: () => setPlaying(false),
  pose: (name, run = 0) => at(replay.runs[run], replay.runs[run].vehicles.find((vehicle) => vehicle.name === name).pose, time),
  drawnAt: (name, run = 0) => drawnAt(replay.runs[run], name),
};
onSeek.forEach((call) => call(time));
