// Solids of the replay, as triangles: the vehicle, the object between two of them, the arrow of the current.

/** Triangles with a colour each, in metres; `add` takes the parts that follow. */
class Solid {
  constructor() {
    this.points = [];
    this.faces = []; // [i, j, k, colour]
  }

  /** A convex part.  Its faces are shaded here, as light from above and ahead would; plotly's own is off. */
  add(points, faces, colour) {
    const first = this.points.length, middle = [0, 1, 2].map((n) => points.reduce((sum, p) => sum + p[n] / points.length, 0));
    this.points.push(...points);
    for (const [i, j, k] of faces) {
      const [a, b, c] = [points[i], points[j], points[k]], normal = unit(cross(minus(b, a), minus(c, a)));
      const sign = dot(normal, minus(a, middle)) < -1e-9 ? -1 : 1;
      const light = 0.98 + sign * dot(normal, [0.1, 0.06, -0.28]);
      this.faces.push([first + i, first + j, first + k, shaded(colour, light)]);
    }
    return this;
  }

  /** A box between two corners. */
  box([x0, y0, z0], [x1, y1, z1], colour) {
    const points = [];
    for (const x of [x0, x1]) for (const y of [y0, y1]) for (const z of [z0, z1]) points.push([x, y, z]);
    const sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    return this.add(points, sides.flatMap(([a, b, c, d]) => [[a, b, c], [a, c, d]]), colour);
  }

  /** A body of revolution about the line from `from` along the unit vector `along`: rings [[distance, radius], ...]. */
  turned(from, along, rings, colour, sides = 12) {
    const across = Math.abs(along[2]) < 0.9 ? unit(cross(along, [0, 0, 1])) : [1, 0, 0];
    const other = cross(along, across);
    const points = [];
    for (const [distance, radius] of rings) {
      for (let s = 0; s < sides; s++) {
        const c = radius * Math.cos((2 * Math.PI * s) / sides), d = radius * Math.sin((2 * Math.PI * s) / sides);
        points.push([0, 1, 2].map((n) => from[n] + distance * along[n] + c * across[n] + d * other[n]));
      }
    }
    const faces = [];
    for (let r = 0; r + 1 < rings.length; r++) {
      for (let s = 0; s < sides; s++) {
        const a = r * sides + s, b = r * sides + ((s + 1) % sides);
        faces.push([a, b, b + sides], [a, b + sides, a + sides]);
      }
    }
    return this.add(points, faces, colour);
  }

  tube(from, to, radius, colour, sides = 12) {
    const way = [0, 1, 2].map((n) => to[n] - from[n]), length = Math.hypot(...way);
    return this.turned(from, unit(way), [[0, 0], [0, radius], [length, radius], [length, 0]], colour, sides);
  }
}

const minus = (a, b) => a.map((value, n) => value - b[n]);
const dot = (a, b) => a.reduce((sum, value, n) => sum + value * b[n], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((value) => value / (Math.hypot(...a) || 1));

/** A colour #rrggbb in light from 0, black, over 1, itself, to 2, white. */
function shaded(colour, light) {
  const parts = [1, 3, 5].map((n) => parseInt(colour.slice(n, n + 2), 16));
  return "#" + parts.map((v) => Math.round(light < 1 ? v * light : v + (255 - v) * (light - 1)).toString(16).padStart(2, "0")).join("");
}

/**
 * A vehicle of the size of a BlueROV2 (0.457 x 0.338 x 0.254 m) in its own frame: x ahead, y to starboard, z down.
 * Points 8 to 23 are the corners of its side plates, around its origin.  Dome and arrow show where it heads.
 */
function rov(colour) {
  const frame = ink("frame"), solid = new Solid();
  solid.box([-0.2, -0.15, 0.11], [0.2, 0.15, 0.127], frame);
  for (const y of [-0.165, 0.15]) solid.box([-0.2285, y, -0.115], [0.2285, y + 0.015, 0.115], frame);
  for (const y of [-0.169, 0.035]) {
    solid.box([-0.22, y, -0.127], [0.18, y + 0.134, -0.065], colour);
    solid.box([0.18, y + 0.02, -0.12], [0.2285, y + 0.114, -0.07], colour);
  }
  solid.tube([-0.18, 0, -0.01], [0.15, 0, -0.01], 0.057, "#c9d1d9");
  const dome = [0, 15, 30, 45, 60, 75, 90].map((a) => [0.057 * Math.sin((a * Math.PI) / 180), 0.057 * Math.cos((a * Math.PI) / 180)]);
  solid.turned([0.15, 0, -0.01], [1, 0, 0], dome, ink("glass"));
  solid.tube([-0.15, 0, 0.075], [0.13, 0, 0.075], 0.037, "#8b949e");
  for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
    const along = unit([1, -x * y, 0]), middle = [0.155 * x, 0.115 * y, 0.04];
    const end = (sign) => middle.map((value, n) => value + sign * 0.035 * along[n]);
    solid.tube(end(-1), end(1), 0.042, frame, 10);
  }
  for (const y of [-0.105, 0.105]) solid.tube([-0.02, y, -0.134], [-0.02, y, -0.05], 0.045, frame, 10);
  const arrow = [[0.34, 0, -0.2], [0.12, -0.11, -0.2], [0.12, 0.11, -0.2], [0.12, -0.035, -0.2], [0.12, 0.035, -0.2], [-0.2, -0.035, -0.2], [-0.2, 0.035, -0.2]];
  return solid.add(arrow, [[0, 1, 2], [3, 5, 6], [3, 6, 4]], colour);
}

/** Points of a body in NED: turned by zyx Euler angles, scaled, moved.  pose: x, y, z [m], phi, theta, psi [rad]. */
function placed(points, [x, y, z, phi, theta, psi], scale) {
  const [a, b, c, d, e, f] = [Math.cos(phi), Math.sin(phi), Math.cos(theta), Math.sin(theta), Math.cos(psi), Math.sin(psi)];
  const turn = [
    [e * c, e * d * b - f * a, e * d * a + f * b],
    [f * c, f * d * b + e * a, f * d * a - e * b],
    [-d, c * b, c * a],
  ];
  return points.map((p) => [x, y, z].map((at, n) => at + scale * (turn[n][0] * p[0] + turn[n][1] * p[1] + turn[n][2] * p[2])));
}

/** The bar between two points, with ends in another tone. */
function bar(from, to, radius) {
  return new Solid().tube(from, to, radius, ink("object"));
}

/** A small octahedron: the place where a vehicle should be. */
function mark3d([x, y, z], size) {
  return new Solid().turned([x, y, z - size], [0, 0, 1], [[0, 0], [size, size], [2 * size, 0]], ink("reference"), 4);
}

/** An arrow from a point along a vector. */
function arrow(from, way, radius, colour) {
  const length = Math.hypot(...way), head = Math.min(4.5 * radius, 0.5 * length);
  const rings = [[0, 0], [0, radius], [length - head, radius], [length - head, 2.4 * radius], [length, 0]];
  return new Solid().turned(from, unit(way), rings, colour);
}

/** Several solids, [points, faces] each, as one mesh of plotly; NED becomes east, north, down. */
function mesh(solids) {
  const found = { x: [], y: [], z: [], i: [], j: [], k: [], facecolor: [] };
  for (const [points, faces] of solids) {
    const first = found.x.length;
    for (const [north, east, down] of points) {
      found.x.push(east);
      found.y.push(north);
      found.z.push(down);
    }
    for (const [i, j, k, colour] of faces) {
      found.i.push(first + i);
      found.j.push(first + j);
      found.k.push(first + k);
      found.facecolor.push(colour);
    }
  }
  return found;
}
