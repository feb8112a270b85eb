// The scene: what moves, the room around it, and the cameras.  Data are in NED; plotly's axes are east, north and down.

const replay = data.replay;
const WIDE = 1.5, HIGH = 1.05; // what the scene may take up, in units of plotly's camera
const BEHIND = { x: 1.0, y: -1.5, z: 0.9 }; // m east, north and up: from where a followed vehicle is seen
let time = replay ? replay.start : 0; // s, of the replay
let camera = "orbit", offset = null; // offset: of the eye from a followed vehicle, in units of plotly's camera

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
