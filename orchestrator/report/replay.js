// The replay: what moves, the room around it, time, cameras and keys.  NED; the scene shows east, north and down.

const replay = data.replay;
const CAMERAS = ["orbit", "above", "side", "follow"];
const STEPS = { ArrowLeft: -1, ArrowRight: 1 };
const WIDE = 1.5, HIGH = 1.05; // what the scene may take up, in units of plotly's camera
const BEHIND = { x: 1.0, y: -1.5, z: 0.9 }; // m east, north and up: from where a followed vehicle is seen
let time = replay ? replay.start : 0, playing = false, before = 0, camera = "orbit", offset = null, busy = false;

/** Row `i` of six, and the way to the next, at time t: [x, y, z, phi, theta, psi] in m and rad. */
function at(run, rows, t, width = 6) {
  const times = run.time, i = indexAt(times, t), next = Math.min(i + 1, times.length - 1);
  const part = next === i ? 0 : Math.min(1, Math.max(0, (t - times[i]) / (times[next] - times[i])));
  return Array.from({ length: width }, (_, n) => rows[width * i + n] + part * (rows[width * next + n] - rows[width * i + n]));
}

const isShown = (run, vehicle) => shows([`run${run.number}`, vehicle.name]);
const range = () => replay.high.map((high, n) => high - replay.low[n]);

/** Middle of the object at time t, and the unit vector along it. */
function objectAt(run, t) {
  const { vehicles, from, to, rests } = run.object;
  const held = Math.min(Math.max(t, from), to);
  const [a, b] = vehicles.map((n) => at(run, run.vehicles[n].pose, held));
  const middle = t < from ? rests[0] : t > to ? rests[1] : [0, 1, 2].map((n) => (a[n] + b[n]) / 2);
  return [middle, unit([0, 1, 2].map((n) => b[n] - a[n]))];
}

/** Everything that moves, at the time of the replay, as one mesh. */
function moving() {
  const solids = [];
  for (const run of replay.runs) {
    for (const vehicle of run.vehicles) {
      if (!isShown(run, vehicle)) continue;
      const key = tone(vehicle.colour) + darkness.matches;
      if (vehicle.solid?.key !== key) vehicle.solid = { key, ...rov(tone(vehicle.colour)) };
      vehicle.first = solids.reduce((sum, [points]) => sum + points.length, 0);
      solids.push([placed(vehicle.solid.points, at(run, vehicle.pose, time), replay.scale), vehicle.solid.faces]);
    }
    for (const vehicle of run.vehicles) {
      if (!isShown(run, vehicle) || !vehicle.desired || hidden.has("desired")) continue;
      const solid = mark3d(at(run, vehicle.desired, time), 0.06 * replay.scale);
      if (Number.isFinite(solid.points[0][0])) solids.push([solid.points, solid.faces]);
    }
    if (run.object && shows([`run${run.number}`])) {
      const [middle, along] = objectAt(run, time);
      const end = (sign) => middle.map((value, n) => value + (sign * run.object.length * along[n]) / 2 + (n === 2 ? replay.below * replay.scale : 0));
      const solid = bar(end(-1), end(1), replay.thickness * replay.scale);
      solids.push([solid.points, solid.faces]);
    }
  }
  const flow = flowAt(time);
  if (flow && Math.hypot(...flow) > 1e-9) {
    const size = 0.3 * Math.max(...range().slice(0, 2)) / fastest(), solid = arrow(mooring(size), flow.map((v) => v * size), 0.035 * replay.scale, ink("current"));
    solids.push([solid.points, solid.faces]);
  }
  return mesh(solids);
}

const currentRun = () => replay.runs.find((run) => run.current && shows([`run${run.number}`]));

function flowAt(t) {
  const run = currentRun();
  return run ? at(run, run.current, t, 3) : null;
}

/** The greatest speed of any current [m/s]: its arrow has a fixed length, others a fraction of it. */
function fastest() {
  replay.fastest ??= Math.max(...replay.runs.map((run) => {
    let most = 0;
    for (let i = 0; run.current && i < run.current.length; i += 3) most = Math.max(most, Math.hypot(...run.current.subarray(i, i + 3)));
    return most;
  }));
  return replay.fastest;
}

/** Where the arrow of the current begins: in the south-west, with room for its length on either side. */
function mooring(size) {
  const flow = flowAt(time), from = (n) => replay.low[n] + 0.25 + Math.max(0, -flow[n] * size);
  return [from(0), from(1), replay.low[2] + 0.55 * range()[2] - (flow[2] * size) / 2];
}

/** Plumb lines from the vehicles to the floor. */
function plumbs() {
  const lines = { x: [], y: [], z: [] };
  for (const run of replay.runs) {
    for (const vehicle of run.vehicles) {
      if (!isShown(run, vehicle)) continue;
      const [north, east, down] = at(run, vehicle.pose, time);
      lines.x.push(east, east, null);
      lines.y.push(north, north, null);
      lines.z.push(down, replay.high[2], null);
    }
  }
  return lines;
}

const UNLIT = { ambient: 1, diffuse: 0, specular: 0, fresnel: 0 };
const quiet = { hoverinfo: "skip", showlegend: false };

/** What stays: water, floor with a grid of metres, tracks. */
function still() {
  const [n0, e0] = replay.low, [n1, e1] = replay.high, floor = replay.high[2];
  const plane = (z, colour, opacity) => ({
    ...quiet, type: "mesh3d", x: [e0, e1, e1, e0], y: [n0, n0, n1, n1], z: [z, z, z, z], i: [0, 0], j: [1, 2], k: [2, 3],
    color: colour, opacity, lighting: UNLIT,
  });
  const grid = { x: [], y: [], z: [] }, step = Math.max(1, Math.round(Math.max(n1 - n0, e1 - e0) / 14));
  const line = (a, b) => [0, 1].forEach((n) => grid["xy"[n]].push(a[n], b[n], null)) || grid.z.push(floor, floor, null);
  for (let n = Math.ceil(n0 / step) * step; n <= n1; n += step) line([e0, n], [e1, n]);
  for (let e = Math.ceil(e0 / step) * step; e <= e1; e += step) line([e, n0], [e, n1]);
  const found = [plane(0, ink("water"), 0.22), plane(floor, ink("floor"), 0.35)];
  found.push({ ...quiet, type: "scatter3d", mode: "lines", ...grid, line: { color: faint(ink("floor"), 0.9), width: 1 } });
  for (const run of replay.runs) {
    for (const vehicle of run.vehicles) {
      for (const [rows, isDesired] of [[vehicle.desired, true], [vehicle.pose, false]]) {
        if (!rows) continue;
        const axis = (n) => rows.filter((_, i) => i % 6 === n);
        found.push({
          ...quiet, type: "scatter3d", mode: "lines", x: axis(1), y: axis(0), z: axis(2), visible: isShown(run, vehicle) && !(isDesired && hidden.has("desired")),
          line: isDesired ? { color: ink("reference"), width: 2, dash: "dash" } : { color: tone(vehicle.colour), width: 5 },
        });
      }
    }
  }
  return found;
}

function sceneTraces() {
  return [
    { ...quiet, type: "mesh3d", ...moving(), lighting: UNLIT },
    { ...quiet, type: "scatter3d", mode: "lines", ...plumbs(), line: { color: ink("soft"), width: 1.5 } },
    ...still(),
  ];
}

/** A metre in units of plotly's camera: the same along every axis. */
function perMetre() {
  const [north, east, down] = range();
  return Math.min(WIDE / Math.max(north, east), HIGH / down);
}

/** Lengths of the scene's sides in units of plotly's camera. */
function sides() {
  const [north, east, down] = range(), metre = perMetre();
  return { x: metre * east, y: metre * north, z: metre * down };
}

function sceneLayout() {
  const axis = (n, title, more = {}) => ({
    title: { text: title, font: { size: 12 } }, range: n === 2 ? [replay.high[2] + 0.02, replay.low[2]] : [replay.low[n], replay.high[n]],
    showbackground: false, gridcolor: ink("grid"), linecolor: ink("line"), zeroline: false, showspikes: false, showgrid: false,
    tickfont: { size: 11 }, nticks: 6, color: ink("soft"), ...more,
  });
  return {
    margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false, uirevision: "kept",
    font: { color: ink("soft"), family: getComputedStyle(document.body).fontFamily },
    scene: {
      xaxis: axis(1, "East y [m]"), yaxis: axis(0, "North x [m]"), zaxis: axis(2, "Depth z [m]", { nticks: 5 }),
      aspectmode: "manual", aspectratio: sides(), dragmode: "turntable", camera: preset(camera),
    },
  };
}

/** Where a point of NED lies in the coordinates of plotly's camera. */
function inScene([north, east, down]) {
  const size = sides(), extent = range(), part = (value, n) => (value - replay.low[n]) / extent[n] - 0.5;
  return { x: size.x * part(east, 1), y: size.y * part(north, 0), z: -size.z * part(down, 2) };
}

function preset(name) {
  const { clientWidth, clientHeight } = find("space");
  const narrow = Math.max(1, (1.55 * clientHeight) / clientWidth), up = { x: 0, y: 0, z: 1 };
  const far = (x, y, z) => ({ x: x * narrow, y: y * narrow, z: z * narrow });
  if (name === "above") return { eye: far(0, 0, 1.9), center: { x: 0, y: 0, z: 0 }, up: { x: 0, y: 1, z: 0 } };
  if (name === "side") return { eye: far(0, -1.75, 0.1), center: { x: 0, y: 0, z: 0 }, up };
  if (name === "follow") {
    offset ??= Object.fromEntries(Object.entries(BEHIND).map(([axis, metres]) => [axis, metres * perMetre() * replay.scale * narrow]));
    const center = inScene(followedPlace());
    return { eye: { x: center.x + offset.x, y: center.y + offset.y, z: center.z + offset.z }, center, up };
  }
  return { eye: far(0.64, -1.48, 0.54), center: { x: 0, y: 0, z: -0.1 }, up };
}

function followed() {
  const [run, vehicle] = (find("followed").value || "0 0").split(" ").map(Number);
  return [replay.runs[run], replay.runs[run].vehicles[vehicle]];
}

function followedPlace() {
  const [run, vehicle] = followed();
  return at(run, vehicle.pose, time).slice(0, 3);
}

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
