"use strict";
// Draws what report_shapes.py wrote into the page: the shell of every step with its colours, and the obstacles.
// It reads data as data only: whatever comes from a scene is set as text.

const element = (id) => document.getElementById(id);
const create = (tag, parent, text) => {
  const made = parent.appendChild(document.createElement(tag));
  if (text !== undefined) made.textContent = text;
  return made;
};

/** The arrays of the page, unpacked: report_arrays.py backwards. */
async function readArrays() {
  const packed = Uint8Array.from(atob(element("page-arrays").textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  return ({ at, bytes: size, rows, columns }) => {
    const count = rows * columns;
    const values = new { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array }[size](count);
    for (let b = 0; b < size; b++)
      for (let i = 0; i < count; i++) values[i] |= bytes[at + b * count + i] << (8 * b);
    for (let i = 1; i < columns; i++) values[i] += values[i - 1];
    for (let i = columns; i < count; i++) values[i] += values[i - columns];
    return values;
  };
}

/** Points (3 n) in metres of a row of places: all x, then y, then z. */
function unpackPoints({ values, corner, spacing }, row, n) {
  const points = new Float32Array(3 * n);
  for (let i = 0; i < n; i++)
    for (let a = 0; a < 3; a++) points[3 * i + a] = corner[a] + spacing * values[(3 * row + a) * n + i];
  return points;
}

function triangleNormals(points, triangles) {
  const normals = new Float32Array(triangles.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const [i, j, k] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const d = [0, 1, 2].map((a) => points[j + a] - points[i + a]);
    const e = [0, 1, 2].map((a) => points[k + a] - points[i + a]);
    for (let a = 0; a < 3; a++) {
      const [b, c] = [(a + 1) % 3, (a + 2) % 3];
      normals[t + a] = d[b] * e[c] - d[c] * e[b]; // as long as twice the area
    }
  }
  return normals;
}

/** Normals of a smooth surface at the corners of its triangles. */
function smoothNormals(points, triangles) {
  const flat = triangleNormals(points, triangles);
  const sums = new Float32Array(points.length);
  triangles.forEach((v, corner) => {
    for (let a = 0; a < 3; a++) sums[3 * v + a] += flat[corner - (corner % 3) + a];
  });
  return expand(sums, triangles);
}

/** Normals at corners that do not mix triangles that meet at a sharp edge. */
function creasedNormals(points, triangles, crease) {
  const flat = triangleNormals(points, triangles);
  const around = new Map();
  triangles.forEach((v, corner) => {
    const t = corner - (corner % 3);
    if (around.has(v)) around.get(v).push(t);
    else around.set(v, [t]);
  });
  const dot = (s, t) => flat[s] * flat[t] + flat[s + 1] * flat[t + 1] + flat[s + 2] * flat[t + 2];
  const normals = new Float32Array(3 * triangles.length);
  triangles.forEach((v, corner) => {
    const own = corner - (corner % 3);
    for (const t of around.get(v))
      if (dot(own, t) >= crease * Math.sqrt(dot(own, own) * dot(t, t)))
        for (let a = 0; a < 3; a++) normals[3 * corner + a] += flat[t + a];
  });
  return normals;
}

function expand(points, triangles) {
  const corners = new Float32Array(3 * triangles.length);
  triangles.forEach((v, corner) => {
    for (let a = 0; a < 3; a++) corners[3 * corner + a] = points[3 * v + a];
  });
  return corners;
}

// `shade`: the values of a triangle at its three corners, the same at each corner, so that states are not mixed:
// every point of the triangle has the state of the corner that it is nearest to. `behind`: how much further from the
// eye it is drawn, along the line of sight.
const VERTEX = `
  uniform float behind;
  in vec3 shade;
  out vec3 vNormal, vPlace, vCorner;
  flat out vec3 vShade;
  void main() {
    vec4 place = modelViewMatrix * vec4(position, 1.0);
    vPlace = place.xyz;
    vNormal = normalMatrix * normal;
    vShade = shade;
    vCorner = vec3(equal(ivec3(gl_VertexID % 3), ivec3(0, 1, 2)));
    gl_Position = projectionMatrix * vec4(place.xyz * (1.0 + behind / length(place.xyz)), 1.0);
  }`;
const FRAGMENT = `
  uniform sampler2D map;
  uniform float colours, meshLines;
  uniform bool states;
  in vec3 vNormal, vPlace, vCorner;
  flat in vec3 vShade;
  out vec4 colour;
  void main() {
    float value = dot(vShade, vCorner), most = max(vCorner.x, max(vCorner.y, vCorner.z));
    if (states) value = vCorner.x == most ? vShade.x : vCorner.y == most ? vShade.y : vShade.z;
    float share = clamp(value * 255.0 / 254.0, 0.0, 1.0);
    vec3 base = texture(map, vec2((share * (colours - 1.0) + 0.5) / colours, 0.5)).rgb;
    if (max(vShade.x, max(vShade.y, vShade.z)) > 254.5 / 255.0) base = vec3(0.83); // no value
    vec3 n = normalize(gl_FrontFacing ? vNormal : -vNormal);
    vec3 away = -normalize(vPlace);
    float light = 0.45 + 0.55 * max(dot(n, normalize(away + vec3(-0.35, 0.55, 0.2))), 0.0);
    vec3 near = vCorner / fwidth(vCorner);
    float line = 1.0 - smoothstep(0.3, 1.1, min(near.x, min(near.y, near.z)));
    colour = vec4(mix(base * light, vec3(0.1), 0.55 * meshLines * line), 1.0);
  }`;

const CHORD = 0.2; // edges: bodies are drawn behind the chords of a shape on them, seen aslant, too

function meanEdge(points, triangles) {
  let sum = 0;
  for (let k = 0; k < triangles.length; k++) {
    const [a, b] = [3 * triangles[k], 3 * triangles[k % 3 === 2 ? k - 2 : k + 1]];
    sum += Math.hypot(points[a] - points[b], points[a + 1] - points[b + 1], points[a + 2] - points[b + 2]);
  }
  return sum / triangles.length;
}

function mapTexture(hexes, smooth) {
  const texels = Uint8Array.from(hexes.flatMap((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)).concat(255)));
  const texture = new THREE.DataTexture(texels, hexes.length, 1);
  texture.minFilter = texture.magFilter = smooth ? THREE.LinearFilter : THREE.NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

function surface(map, colours, behind = 0) {
  const uniforms = { map: { value: map }, colours: { value: colours }, states: { value: false }, meshLines: { value: 0 }, behind: { value: behind } };
  const material = new THREE.ShaderMaterial({
    uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, glslVersion: THREE.GLSL3, side: THREE.DoubleSide,
  });
  const mesh = new THREE.Mesh(new THREE.BufferGeometry(), material);
  mesh.frustumCulled = false;
  return mesh;
}

function setAttribute(geometry, name, values, size, normalised = false) {
  const old = geometry.attributes[name];
  if (old && old.array.length === values.length) {
    old.array.set(values);
    old.needsUpdate = true;
  } else geometry.setAttribute(name, new THREE.BufferAttribute(values, size, normalised));
}

/** Values per vertex or triangle at each triangle's corners, thrice. */
function shades(values, triangles, perTriangle) {
  const all = new Uint8Array(3 * triangles.length);
  for (let corner = 0; corner < triangles.length; corner++)
    for (let other = 0; other < 3; other++) {
      const t = Math.floor(corner / 3);
      all[3 * corner + other] = values[perTriangle ? t : triangles[3 * t + other]];
    }
  return all;
}

function lines(colour) {
  const made = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial());
  made.material.color.setStyle(colour, "srgb-linear");
  made.frustumCulled = false;
  return made;
}

/** A mesh of the page: its triangles, its points at the first step, and how to get those of a step, if it has several. */
function readMesh(mesh, read) {
  const places = { values: read(mesh.data), ...mesh };
  const at = (step) => unpackPoints(places, step, mesh.data.columns / 3);
  return { triangles: read(mesh.triangles), points: at(0), at: mesh.data.rows > 1 ? at : null };
}

/** Arrows as strokes with two barbs: tails (3 n) and shares of the longest, all x first. */
function arrowStrokes(points, shares, row, n, longest) {
  const strokes = [];
  for (let i = 0; i < n; i++) {
    const way = [0, 1, 2].map((a) => longest * shares[(3 * row + a) * n + i]);
    const length = Math.hypot(...way);
    if (length === 0) continue;
    const tail = [0, 1, 2].map((a) => points[3 * i + a]);
    const least = [0, 1, 2].reduce((m, a) => (Math.abs(way[a]) < Math.abs(way[m]) ? a : m), 0);
    const aside = [0, 1, 2].map((a) => (a === least ? 1 : 0) - (way[least] * way[a]) / length ** 2);
    const size = (0.1 * length) / Math.hypot(...aside);
    const tip = tail.map((x, a) => x + way[a]);
    const barb = (sign) => tip.map((x, a) => x - 0.25 * way[a] + sign * size * aside[a]);
    strokes.push(...tail, ...tip, ...tip, ...barb(1), ...tip, ...barb(-1));
  }
  return new Float32Array(strokes);
}

const short = (x) => (x === 0 ? "0" : Number(x.toPrecision(4)).toString());

class Viewer {
  constructor(meta, read) {
    Object.assign(this, { meta, read, withBodies: true, state: { step: meta.steps.length + (meta.first ?? -1), field: null, shape: "step" } });
    this.triangles = read(meta.triangles);
    this.boundary = read(meta.boundary);
    this.numbers = read(meta.numbers);
    this.places = { values: read(meta.points.data), ...meta.points };
    this.stills = Object.fromEntries(["start", "rest"].filter((s) => meta[s]).map((s) => [s, readMesh(meta[s], read)]));
    this.fields = new Map(meta.fields.map((field) => [field.name, field]));
    this.maps = Object.fromEntries(Object.entries(meta.maps).map(([name, hexes]) => [name, mapTexture(hexes, name !== "contact")]));
    const renderer = new THREE.WebGLRenderer({ canvas: element("canvas"), antialias: true, preserveDrawingBuffer: true });
    renderer.outputColorSpace = "srgb-linear"; // colours are shown as they are given
    this.renderer = renderer;
    this.scene = new THREE.Scene();
    this.shell = surface(null, 1);
    this.outline = lines("#1b1f24");
    this.startLines = lines("#8a949e");
    this.startLines.visible = false;
    this.arrows = lines(meta.colours.arrow);
    this.scene.add(this.shell, this.outline, this.startLines, this.arrows);
    setAttribute(this.startLines.geometry, "position", expand(this.stills.start.points, this.boundary), 3);
    if (meta.reactions) this.shares = new Int16Array(read(meta.reactions.data).buffer);
    this.bodies = meta.bodies.map((body) => this.addBody(body));
    this.camera = new THREE.PerspectiveCamera(24, 4 / 3, 1e-3 * meta.size, 1e3 * meta.size);
    this.camera.up.set(...meta.up);
    this.controls = new THREE.OrbitControls(this.camera, element("canvas"));
    this.controls.addEventListener("change", () => this.draw());
    this.controls.listenToKeyEvents(element("canvas"));
    // A graphics driver that starts anew, as where a machine wakes, forgets what it has drawn.
    element("canvas").addEventListener("webglcontextrestored", () => this.draw());
  }

  addBody(body) {
    const { points, triangles, at } = readMesh(body, this.read);
    const colours = mapTexture([this.meta.colours.mark, this.meta.colours.body], false);
    const made = surface(colours, 2, CHORD * meanEdge(this.stills.start.points, this.triangles));
    const marks = body.marks ? this.read(body.marks) : new Uint8Array(points.length / 3).fill(254);
    const shape = (corners) => {
      setAttribute(made.geometry, "position", expand(corners, triangles), 3);
      setAttribute(made.geometry, "normal", creasedNormals(corners, triangles, Math.cos((40 * Math.PI) / 180)), 3);
    };
    shape(points);
    setAttribute(made.geometry, "shade", shades(marks, triangles, false), 3, true);
    made.matrixAutoUpdate = false;
    this.scene.add(made);
    return { made, placements: body.placements, deform: at && ((step) => shape(at(step))) };
  }

  /** Shows a step, a field and a shape; what is not named stays. */
  show(change) {
    Object.assign(this.state, change);
    const { step, field, shape } = this.state;
    const data = this.fields.get(field);
    const still = shape === "step" ? null : this.stills[shape];
    const points = still ? still.points : unpackPoints(this.places, step, this.meta.vertices);
    const triangles = still ? still.triangles : this.triangles;
    const geometry = this.shell.geometry;
    setAttribute(geometry, "position", expand(points, triangles), 3);
    setAttribute(geometry, "normal", smoothNormals(points, triangles), 3);
    data.values ??= this.read(data.data);
    const values = data.values.subarray(step * data.data.columns, (step + 1) * data.data.columns);
    // a rest shape with vertices of its own has the same triangles in the same order
    setAttribute(geometry, "shade", shades(values, this.triangles, data.location === "cell"), 3, true);
    const uniforms = this.shell.material.uniforms;
    uniforms.map.value = this.maps[data.map];
    uniforms.colours.value = this.meta.maps[data.map].length;
    uniforms.states.value = Boolean(data.states);
    setAttribute(this.outline.geometry, "position", expand(points, this.boundary), 3);
    this.outline.visible = !still || points.length === 3 * this.meta.vertices;
    this.points = points;
    if (this.shares) {
      const { longest } = this.meta.reactions;
      const strokes = still ? new Float32Array() : arrowStrokes(points, this.shares, step, this.meta.vertices, longest);
      this.arrows.geometry.dispose();
      this.arrows.geometry = new THREE.BufferGeometry();
      setAttribute(this.arrows.geometry, "position", strokes, 3);
    }
    for (const { made, placements, deform } of this.bodies) {
      deform?.(step);
      made.visible = this.withBodies && shape !== "rest"; // the rest shape need not be where they are
      made.matrix.set(...placements[Math.min(step, placements.length - 1)]);
      made.matrixWorldNeedsUpdate = true;
    }
    this.draw();
    return data;
  }

  look(name) {
    const { position, focus, angle } = this.meta.views[name];
    this.camera.fov = angle;
    this.camera.updateProjectionMatrix();
    this.camera.position.set(...position);
    this.controls.target.set(...focus);
    this.controls.update();
    this.draw();
  }

  /** Moves the view to another shape's middle, as far off as it is large, in the direction that there is. */
  centre(points) {
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    points.forEach((x, i) => {
      low[i % 3] = Math.min(low[i % 3], x);
      high[i % 3] = Math.max(high[i % 3], x);
    });
    const middle = new THREE.Vector3(...low.map((x, a) => (x + high[a]) / 2));
    const radius = 0.5 * Math.hypot(...low.map((x, a) => high[a] - x));
    const away = this.camera.position.clone().sub(this.controls.target).normalize();
    const distance = (1.25 * radius) / Math.sin((this.camera.fov * Math.PI) / 360);
    this.controls.target.copy(middle);
    this.camera.position.copy(middle).addScaledVector(away, distance);
    this.controls.update();
    this.draw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = element("canvas");
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  draw() {
    this.wanted ??= requestAnimationFrame(() => {
      this.wanted = null;
      this.renderer.setClearColor(0xffffff); // a new context has another one
      this.renderer.render(this.scene, this.camera);
    });
  }

  /** The vertex nearest to what is seen at a place of the canvas (-1 to 1, y up); undefined beside the shell. */
  pick(x, y) {
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2(x, y), this.camera);
    this.shell.geometry.boundingSphere = null;
    const [hit] = ray.intersectObject(this.shell);
    if (!hit) return undefined;
    const still = this.stills[this.state.shape];
    const triangles = still ? still.triangles : this.triangles;
    const t = 3 * Math.floor(hit.face.a / 3);
    const corner = [0, 1, 2].reduce((best, k) => {
      const distance = (c) => hit.point.distanceTo(new THREE.Vector3().fromArray(this.points, 3 * triangles[t + c]));
      return distance(k) < distance(best) ? k : best;
    }, 0);
    return { triangle: t / 3, vertex: triangles[t + corner], own: this.triangles[t + corner] };
  }
}
