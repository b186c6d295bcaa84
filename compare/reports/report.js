"use strict";
// All views of the page are drawn by one WebGL context, off the page, and copied to the canvas of each: a browser keeps
// few contexts, and what stands in a canvas can be printed.
const data = JSON.parse(document.getElementById("data").textContent);
const tip = document.getElementById("tip");
const style = getComputedStyle(document.documentElement);
const FIELD_OF_VIEW = 26 * Math.PI / 180, MOST_BUFFERS = 60;
const LIGHT = { surface: [0.79, 0.80, 0.82], held: [0.30, 0.45, 0.69], moved: [0.87, 0.52, 0.32] };
// As in compare.reports.views: of a camera at azimuth 0, what is to the right, up, and towards the viewer.
const BASES = { x: [[0, 1, 0], [1, 0, 0], [0, 0, -1]], y: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], z: [[1, 0, 0], [0, 0, 1], [0, -1, 0]] };
let printing = false;

// Numbers from the page

const decoded = new Map();
function bytes(name) {
  if (!decoded.has(name)) {
    const text = atob(data.arrays[name]), out = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
    decoded.set(name, out.buffer);
  }
  return decoded.get(name);
}
const meshes = new Map();
function meshOf(one, name) {
  const key = one.number + " " + name;
  if (meshes.has(key)) return meshes.get(key);
  const pane = one.scene.panes[name], raw = new Uint16Array(bytes(pane.points)), count = raw.length / 3;
  const points = new Float32Array(raw.length), normals = new Float32Array(raw.length);
  for (let i = 0; i < raw.length; i++) points[i] = pane.lower[i % 3] + raw[i] / 65535 * pane.size[i % 3];
  const faces = pane.wide ? new Uint32Array(bytes(pane.faces)) : new Uint16Array(bytes(pane.faces));
  for (let k = 0; k < faces.length; k += 3) {
    const [a, b, c] = [3 * faces[k], 3 * faces[k + 1], 3 * faces[k + 2]];
    const u = [0, 1, 2].map(d => points[b + d] - points[a + d]), v = [0, 1, 2].map(d => points[c + d] - points[a + d]);
    const n = cross(u, v);
    for (const at of [a, b, c]) for (let d = 0; d < 3; d++) normals[at + d] += n[d];
  }
  const values = pane.values === null ? null : new Int16Array(bytes(pane.values)), colours = new Float32Array(raw.length);
  for (let i = 0; i < count; i++) colours.set(colourOf(one.scene, name, values === null ? null : values[i]), 3 * i);
  const mesh = { points, normals, faces, colours, values };
  meshes.set(key, mesh);
  if (meshes.size > MOST_BUFFERS) meshes.delete(meshes.keys().next().value);
  return mesh;
}
function colourOf(scene, name, value) {
  if (value === null) return LIGHT.surface;
  if (name === "before") return value === 0 ? LIGHT.surface : scene.holds[value - 1] ? LIGHT.held : LIGHT.moved;
  if (value === -32768) return LIGHT.surface;
  const share = value / 32767 * scene.top / scene.limit;  // of the strongest colour
  const table = data.colours[scene.oneSided ? "from zero" : "about zero"];
  const at = (table.length - 1) * Math.min(1, Math.max(0, scene.oneSided ? share : (share + 1) / 2)), k = Math.floor(at);
  const next = table[Math.min(k + 1, table.length - 1)];
  return table[k].map((c, d) => c + (next[d] - c) * (at - k));
}
const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
const dot = (u, v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];

// Drawing

const stage = document.createElement("canvas");
const gl = stage.getContext("webgl", { antialias: true, alpha: true, premultipliedAlpha: true, preserveDrawingBuffer: true });
let program = null, places = {}, buffers = new Map();
function prepare() {
  const compiled = (kind, source) => { const shader = gl.createShader(kind); gl.shaderSource(shader, source); gl.compileShader(shader); return shader; };
  program = gl.createProgram();
  gl.attachShader(program, compiled(gl.VERTEX_SHADER, `attribute vec3 point, normal, colour; uniform mat4 view; varying vec3 n, c;
    void main() { gl_Position = view * vec4(point, 1.0); n = normal; c = colour; }`));
  gl.attachShader(program, compiled(gl.FRAGMENT_SHADER, `precision mediump float; varying vec3 n, c; uniform vec3 key, eye; uniform float flatness;
    void main() { vec3 m = normalize(n); if (!gl_FrontFacing) m = -m;
      float shade = 0.36 + 0.46 * max(dot(m, key), 0.0) + 0.24 * max(dot(m, eye), 0.0);
      gl_FragColor = vec4(mix(c * min(shade, 1.08), vec3(0.0), flatness), 1.0); }`));
  gl.linkProgram(program); gl.useProgram(program); gl.enable(gl.DEPTH_TEST); gl.clearColor(0, 0, 0, 0);
  gl.getExtension("OES_element_index_uint");
  for (const name of ["point", "normal", "colour"]) { places[name] = gl.getAttribLocation(program, name); gl.enableVertexAttribArray(places[name]); }
  for (const name of ["view", "key", "eye", "flatness"]) places[name] = gl.getUniformLocation(program, name);
  buffers = new Map();
}
if (gl) {
  prepare();
  stage.addEventListener("webglcontextlost", event => event.preventDefault());
  stage.addEventListener("webglcontextrestored", () => { prepare(); for (const one of cases) refresh(one); });
}
function bufferOf(one, name) {
  const key = one.number + " " + name;
  if (buffers.has(key)) return buffers.get(key);
  if (buffers.size >= MOST_BUFFERS) {
    const oldest = buffers.keys().next().value;
    for (const buffer of Object.values(buffers.get(oldest).of)) gl.deleteBuffer(buffer);
    buffers.delete(oldest);
  }
  const mesh = meshOf(one, name), of = {};
  for (const [what, array] of [["point", mesh.points], ["normal", mesh.normals], ["colour", mesh.colours]]) {
    of[what] = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, of[what]); gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
  }
  of.faces = gl.createBuffer(); gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, of.faces); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.faces, gl.STATIC_DRAW);
  const made = { of, count: mesh.faces.length, kind: mesh.faces instanceof Uint32Array ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT };
  buffers.set(key, made);
  return made;
}
// What the camera of a case sees: its axes, and the matrix for a picture of some width and height.
function look(one, width, height) {
  const { azimuth, elevation, zoom, shift, up } = one.camera, a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
  const [aside, upwards, towards] = BASES[up], mix = (p, q, r) => [0, 1, 2].map(d => p * aside[d] + q * upwards[d] + r * towards[d]);
  const back = mix(Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)), right = mix(Math.cos(a), 0, -Math.sin(a)), top = cross(back, right);
  const distance = 1 / Math.sin(FIELD_OF_VIEW / 2), focal = zoom * 1.04 / Math.tan(FIELD_OF_VIEW / 2), aspect = width / height;
  const fx = aspect >= 1 ? focal / aspect : focal, fy = aspect >= 1 ? focal : focal * aspect, near = distance - 1.7, far = distance + 1.7;
  const A = (far + near) / (far - near), B = -2 * far * near / (far - near);
  const row = (axis, f, s) => [f * axis[0], f * axis[1], f * axis[2], -f * s];
  const rx = row(right, fx, shift[0]), ry = row(top, fy, shift[1]), w = [-back[0], -back[1], -back[2], distance];
  const rz = [A * w[0], A * w[1], A * w[2], A * w[3] + B], matrix = new Float32Array(16);
  for (let k = 0; k < 4; k++) { matrix[4 * k] = rx[k]; matrix[4 * k + 1] = ry[k]; matrix[4 * k + 2] = rz[k]; matrix[4 * k + 3] = w[k]; }
  const at = (r, p) => r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3];
  const project = p => { const d = at(w, p); return [(at(rx, p) / d + 1) / 2 * width, (1 - at(ry, p) / d) / 2 * height, d]; };
  return { matrix, right, top, back, project };
}
function render(one, name, seen, width, height, flat) {
  if (stage.width !== width || stage.height !== height) { stage.width = width; stage.height = height; }
  gl.viewport(0, 0, width, height); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const { of, count, kind } = bufferOf(one, name);
  for (const what of ["point", "normal", "colour"]) { gl.bindBuffer(gl.ARRAY_BUFFER, of[what]); gl.vertexAttribPointer(places[what], 3, gl.FLOAT, false, 0, 0); }
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, of.faces);
  gl.uniformMatrix4fv(places.view, false, seen.matrix);
  const key = [0, 1, 2].map(d => seen.back[d] + 0.75 * seen.top[d] - 0.55 * seen.right[d]), length = Math.hypot(...key);
  gl.uniform3fv(places.key, key.map(c => c / length)); gl.uniform3fv(places.eye, seen.back); gl.uniform1f(places.flatness, flat ? 1 : 0);
  gl.drawElements(gl.TRIANGLES, count, kind, 0);
}
// The outline of the shape before, as a picture: what the shape covers made broader, less what it covers.
function outline(one, seen, width, height, ratio, ink) {
  const key = [width, height, ink, JSON.stringify(one.camera)].join();
  if (one.outline?.key === key) return one.outline.picture;
  render(one, "before", seen, width, height, true);
  const picture = document.createElement("canvas"); picture.width = width; picture.height = height;
  const pen = picture.getContext("2d"), broad = 0.85 * ratio;
  for (let k = 0; k < 12; k++) pen.drawImage(stage, broad * Math.cos(k * Math.PI / 6), broad * Math.sin(k * Math.PI / 6));
  pen.globalCompositeOperation = "destination-out"; pen.drawImage(stage, 0, 0);
  pen.globalCompositeOperation = "source-in"; pen.fillStyle = ink; pen.fillRect(0, 0, width, height);
  one.outline = { key, picture };
  return picture;
}
function arrow(pen, from, to, ratio, ink, halo) {
  let [dx, dy] = [to[0] - from[0], to[1] - from[1]], length = Math.hypot(dx, dy);
  if (length < 7 * ratio) {  // at the viewer, a point in a ring; away, a cross in it
    for (const [colour, extra] of [[halo, 2.4 * ratio], [ink, 0]]) {
      pen.strokeStyle = pen.fillStyle = colour; pen.lineWidth = 1.8 * ratio + extra;
      pen.beginPath(); pen.arc(from[0], from[1], 6 * ratio, 0, 7); pen.stroke();
      const r = 3.6 * ratio;
      pen.beginPath();
      if (to[2] < from[2]) { pen.arc(from[0], from[1], 1.8 * ratio + extra / 2, 0, 7); pen.fill(); }
      else { for (const s of [1, -1]) { pen.moveTo(from[0] - r, from[1] - s * r); pen.lineTo(from[0] + r, from[1] + s * r); } pen.stroke(); }
    }
    return;
  }
  [dx, dy] = [dx / length, dy / length];
  const head = 8 * ratio, tail = [from[0], from[1]], end = [to[0], to[1]];
  for (const [colour, extra] of [[halo, 2.4 * ratio], [ink, 0]]) {
    pen.strokeStyle = pen.fillStyle = colour; pen.lineWidth = 2 * ratio + extra; pen.lineJoin = "round"; pen.lineCap = "round";
    pen.beginPath(); pen.moveTo(...tail); pen.lineTo(end[0] - dx * head * 0.7, end[1] - dy * head * 0.7); pen.stroke();
    pen.beginPath(); pen.moveTo(...end); pen.lineTo(end[0] - dx * head - dy * head * 0.45, end[1] - dy * head + dx * head * 0.45);
    pen.lineTo(end[0] - dx * head + dy * head * 0.45, end[1] - dy * head - dx * head * 0.45); pen.closePath();
    if (extra) pen.stroke();
    pen.fill();
  }
}
function paint(view) {
  const { canvas, one, name } = view, box = canvas.getBoundingClientRect();
  const ratio = printing ? 2.5 : Math.min(2.5, Math.max(1, devicePixelRatio || 1));
  const width = Math.max(16, Math.round(box.width * ratio)), height = Math.max(16, Math.round(box.height * ratio));
  if (!gl) { canvas.replaceWith(Object.assign(document.createElement("p"), { className: "aside", textContent: "This browser draws no WebGL; the files below open in any viewer of meshes." })); return; }
  canvas.width = width; canvas.height = height;
  const pen = canvas.getContext("2d"), seen = look(one, width, height);
  const ink = printing ? "#000000" : style.getPropertyValue("--outline").trim(), halo = printing ? "#ffffff" : style.getPropertyValue("--paper").trim();
  const before = name !== "before" && one.scene.panes.before ? outline(one, seen, width, height, ratio, ink) : null;
  render(one, name, seen, width, height, false);
  pen.drawImage(stage, 0, 0);
  if (before) pen.drawImage(before, 0, 0);
  if (name === "before" || view.small) for (const [from, to] of one.scene.arrows) arrow(pen, seen.project(from), seen.project(to), ratio, ink, halo);
  canvas.dataset.drawn = "yes";
  document.documentElement.dataset.firstPicture ??= Math.round(performance.now());
}

// Which views are drawn: those in sight. What leaves the window gives its memory back.

const views = [], cases = Array.from(document.querySelectorAll("section.case"), section => {
  const number = Number(section.dataset.case), scene = data.cases[number];
  return { section, number, scene, views: [], camera: scene && start(scene) };
});
const byNumber = new Map(cases.map(one => [one.number, one]));
function start(scene) { return { azimuth: scene.azimuth, elevation: scene.elevation, up: scene.up, zoom: 1, shift: [0, 0] }; }
for (const canvas of document.querySelectorAll("canvas[data-pane]")) {
  const one = byNumber.get(Number(canvas.dataset.case));
  if (!one?.scene) continue;
  const view = { canvas, one, name: canvas.dataset.pane, small: canvas.classList.contains("thumb"), near: false, waiting: false };
  one.views.push(view); views.push(view);
}
const queue = new Set();
let running = false;
function ask(view) { queue.add(view); if (!running) { running = true; requestAnimationFrame(work); } }
function work() {
  const until = performance.now() + 24;
  for (const view of queue) { queue.delete(view); if (view.near || printing) paint(view); if (performance.now() > until) break; }
  running = queue.size > 0;
  if (running) requestAnimationFrame(work);
}
function refresh(one) {
  one.section.dataset.camera = [one.camera.azimuth, one.camera.elevation, one.camera.zoom, ...one.camera.shift].map(x => x.toFixed(3)).join(" ") + " " + one.camera.up;
  for (const button of one.section.querySelectorAll("button[data-up]")) button.setAttribute("aria-pressed", button.dataset.up === one.camera.up);
  for (const view of one.views) if (view.near) ask(view);
}
const watcher = new IntersectionObserver(entries => {
  for (const entry of entries) {
    const view = views.find(other => other.canvas === entry.target);
    view.near = entry.isIntersecting;
    if (view.near) ask(view);
    else if (!printing) { view.canvas.width = view.canvas.height = 0; view.canvas.dataset.drawn = "no"; if (!view.one.views.some(other => other.near)) view.one.outline = null; }
  }
}, { rootMargin: "250px" });
for (const view of views) watcher.observe(view.canvas);
for (const one of cases) if (one.scene) refresh(one);
addEventListener("resize", () => { for (const view of views) if (view.near) ask(view); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { for (const view of views) if (view.near) ask(view); });
function print() { if (printing) return; printing = true; for (const view of views) paint(view); }
function printed() { printing = false; for (const view of views) if (view.near) ask(view); else { view.canvas.width = view.canvas.height = 0; view.canvas.dataset.drawn = "no"; } }
addEventListener("beforeprint", print); addEventListener("afterprint", printed);
matchMedia("print").addEventListener("change", event => event.matches ? print() : printed());

// Turning, shifting and zooming: of all views of a case together

const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
function zoomBy(one, factor) { one.camera.zoom = clamp(one.camera.zoom * factor, 0.3, 20); refresh(one); }
function turn(one, dx, dy) { one.camera.azimuth -= dx; one.camera.elevation = clamp(one.camera.elevation + dy, -89, 89); refresh(one); }
for (const view of views.filter(view => !view.small)) {
  const { canvas, one } = view;
  let last = null;
  canvas.addEventListener("pointerdown", event => { last = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); canvas.classList.add("held"); tip.style.display = "none"; });
  canvas.addEventListener("pointermove", event => {
    if (last === null) { hover(view, event); return; }
    const dx = event.clientX - last[0], dy = event.clientY - last[1], size = Math.min(canvas.clientWidth, canvas.clientHeight);
    last = [event.clientX, event.clientY];
    if (event.shiftKey || event.buttons === 4) {
      one.camera.shift = [one.camera.shift[0] - 2 * dx / size / one.camera.zoom, one.camera.shift[1] + 2 * dy / size / one.camera.zoom]; refresh(one);
    } else turn(one, 180 * dx / size, 140 * dy / size);
  });
  const release = () => { last = null; canvas.classList.remove("held"); };
  canvas.addEventListener("pointerup", release); canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointerleave", () => { tip.style.display = "none"; });
  canvas.addEventListener("dblclick", () => reset(one));
  canvas.addEventListener("wheel", event => {
    const said = one.section.querySelector(".said");
    if (!event.ctrlKey && !event.metaKey) { if (said) said.textContent = "Hold Ctrl to zoom with the wheel."; return; }
    event.preventDefault();
    if (said) said.textContent = "";
    zoomBy(one, Math.exp(-clamp(event.deltaY, -120, 120) / 400));
  }, { passive: false });
  canvas.addEventListener("keydown", event => {
    const moves = { ArrowLeft: [-8, 0], ArrowRight: [8, 0], ArrowUp: [0, -8], ArrowDown: [0, 8] };
    if (moves[event.key]) turn(one, ...moves[event.key]);
    else if (event.key === "+" || event.key === "=") zoomBy(one, 1.15);
    else if (event.key === "-") zoomBy(one, 1 / 1.15);
    else if (event.key === "0") reset(one);
    else return;
    event.preventDefault();
  });
}
function reset(one) { one.camera = start(one.scene); refresh(one); }
for (const one of cases.filter(one => one.scene)) {
  one.section.querySelector("button.reset")?.addEventListener("click", () => reset(one));
  for (const button of one.section.querySelectorAll("button[data-up]")) button.addEventListener("click", () => {
    for (const other of cases) if (other.scene && other.scene.shape === one.scene.shape) { other.scene.up = other.camera.up = button.dataset.up; refresh(other); }
  });
}

// The value under the pointer

let hovering = false;
function hover(view, event) {
  if (view.name === "before" || hovering || event.pointerType === "touch") return;
  hovering = true;
  requestAnimationFrame(() => {
    hovering = false;
    const box = view.canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    const value = valueAt(view, x, y, box.width, box.height);
    tip.style.display = value === null ? "none" : "block";
    if (value === null) return;
    const scene = view.one.scene, percent = 100 * value / scene.unit;
    tip.textContent = scene.isLength ? `${plain(percent)} % of the motion (${plain(value)})` : `${plain(percent)} %`;
    tip.style.left = event.clientX + 14 + "px"; tip.style.top = event.clientY + 12 + "px";
  });
}
function plain(value) {
  const text = Math.abs(value) >= 1e-4 || value === 0 ? String(Number(value.toPrecision(2))) : value.toExponential(1);
  return text.replace("-", "\u2212");
}
function valueAt(view, x, y, width, height) {
  const mesh = meshOf(view.one, view.name);
  if (mesh.values === null) return null;
  const { project } = look(view.one, width, height), count = mesh.points.length / 3, flat = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) flat.set(project(mesh.points.subarray(3 * i, 3 * i + 3)), 3 * i);
  let best = null, nearest = Infinity;
  for (let k = 0; k < mesh.faces.length; k += 3) {
    const [a, b, c] = [3 * mesh.faces[k], 3 * mesh.faces[k + 1], 3 * mesh.faces[k + 2]];
    const area = (flat[b] - flat[a]) * (flat[c + 1] - flat[a + 1]) - (flat[c] - flat[a]) * (flat[b + 1] - flat[a + 1]);
    if (area === 0) continue;
    const v = ((x - flat[a]) * (flat[c + 1] - flat[a + 1]) - (flat[c] - flat[a]) * (y - flat[a + 1])) / area;
    const w = ((flat[b] - flat[a]) * (y - flat[a + 1]) - (x - flat[a]) * (flat[b + 1] - flat[a + 1])) / area, u = 1 - v - w;
    if (u < 0 || v < 0 || w < 0) continue;
    const depth = u * flat[a + 2] + v * flat[b + 2] + w * flat[c + 2], values = [a, b, c].map(at => mesh.values[at / 3]);
    if (depth < nearest) { nearest = depth; best = values.includes(-32768) ? null : (u * values[0] + v * values[1] + w * values[2]) / 32767 * view.one.scene.top; }
  }
  return best;
}

// Tables: sorted by a click, with a hint where columns stand outside the window

for (const table of document.querySelectorAll("table.results")) {
  table.querySelectorAll("th").forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    table.querySelectorAll("th").forEach(other => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const key = row => { const cell = row.cells[column]; return "value" in cell.dataset ? (cell.dataset.value === "" ? null : Number(cell.dataset.value)) : cell.textContent; };
    // What has no value stands last, whichever way the rest goes.
    const order = (a, b) => a === b ? 0 : a === null ? 1 : b === null ? -1 : (a < b ? -1 : 1) * (up ? 1 : -1);
    const rows = Array.from(table.tBodies[0].rows).sort((a, b) => order(key(a), key(b)));
    for (const row of rows) { row.classList.remove("new"); row.cells[0].classList.remove("again"); table.tBodies[0].append(row); }
  }));
}
const hint = () => { for (const box of document.querySelectorAll(".table")) {
  const scroll = box.querySelector(".scroll"), edge = scroll.getBoundingClientRect().right + 1;
  const hidden = Array.from(box.querySelectorAll("thead th")).filter(head => head.getBoundingClientRect().right > edge).length;
  box.classList.toggle("wide", hidden > 0);
  box.querySelector(".more-columns").textContent = hidden ? `${hidden} more ${hidden === 1 ? "column" : "columns"} to the right: scroll the table sideways.` : "";
} };
hint(); addEventListener("resize", hint);
for (const scroll of document.querySelectorAll(".scroll")) scroll.addEventListener("scroll", hint, { passive: true });
