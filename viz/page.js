"use strict";
// Draws the data that viz/page.py wrote into the page: nodes, outlines and colours of plates follow a texture of frames.
const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
const STILL = -32768; // stands for NaN

// Height of a node, interpolated between two frames, in units of the largest displacement.
const HEIGHT = `#version 300 es
precision highp float; precision highp int; precision highp isampler2DArray;
uniform isampler2DArray heights, colours;
uniform mat4 view; uniform ivec2 grid; uniform ivec4 frames; uniform float part, tall;
float read(isampler2DArray field, int node, int frame) {
  return float(texelFetch(field, ivec3(node % grid.x, node / grid.x, frame), 0).r);
}
float known(float value) { return value == ${STILL}.0 ? 0.0 : value; }
float height(int node) {
  return tall * mix(known(read(heights, node, frames.x)), known(read(heights, node, frames.y)), part) / 32767.0;
}
`;
const SURFACE = HEIGHT + `
in vec2 place; out float value; out float missing; out vec3 mixed;
uniform sampler2D table; uniform vec2 limits; uniform bool cyclic;
void main() {
  int node = gl_VertexID;
  float first = read(colours, node, frames.z), second = read(colours, node, frames.w);
  missing = first == ${STILL}.0 || second == ${STILL}.0 ? 1.0 : 0.0;
  value = (mix(first, second, part) / 32767.0 - limits.x) / (limits.y - limits.x);
  mixed = texture(table, vec2(value, 0.5)).rgb;
  gl_Position = view * vec4(place, height(node), 1.0);
}`;
const SURFACE_COLOUR = `#version 300 es
precision highp float;
in float value; in float missing; in vec3 mixed; out vec4 colour;
uniform sampler2D table; uniform bool cyclic; uniform vec3 none;
void main() {
  vec3 shown = cyclic ? mixed : texture(table, vec2(value, 0.5)).rgb;
  colour = vec4(missing > 0.001 ? mix(shown, none, min(1.0, missing)) : shown, 1.0);
}`;
// A segment of a line, with its width in pixels; each end follows the three nodes of its triangle.
const LINE = HEIGHT + `
in vec2 from, to; in ivec3 fromNodes, toNodes; in vec3 fromShares, toShares;
uniform vec2 pixels; uniform float width, nearer;
vec4 placed(vec2 at, ivec3 nodes, vec3 shares) {
  float up = shares.x * height(nodes.x) + shares.y * height(nodes.y) + shares.z * height(nodes.z);
  return view * vec4(at, up, 1.0);
}
void main() {
  vec4 a = placed(from, fromNodes, fromShares), b = placed(to, toNodes, toShares);
  vec2 along = (b.xy - a.xy) * pixels;
  along = length(along) > 0.0 ? normalize(along) : vec2(1.0, 0.0);
  vec2 across = vec2(-along.y, along.x);
  float end = gl_VertexID < 2 ? -1.0 : 1.0, side = gl_VertexID % 2 == 0 ? -1.0 : 1.0;
  vec4 at = end < 0.0 ? a : b;
  at.xy += width * (0.4 * end * along + side * across) / pixels;
  at.z -= nearer;
  gl_Position = at;
}`;
const LINE_COLOUR = `#version 300 es
precision highp float; out vec4 colour; uniform vec4 paint;
void main() { colour = paint; }`;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  const places = new Map();
  return { use: () => gl.useProgram(made), attribute: (name) => gl.getAttribLocation(made, name),
    uniform: (name) => places.get(name) ?? places.set(name, gl.getUniformLocation(made, name)).get(name) };
}

function fieldTexture(gl, text, frames) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
  gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.R16I, ...data.grid, frames, 0, gl.RED_INTEGER, gl.SHORT, new Int16Array(bytes(text)));
  for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, key, gl.NEAREST);
  return texture;
}

function tableTexture(gl) {
  gl.activeTexture(gl.TEXTURE2);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(bytes(data.table)));
  for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.LINEAR);
  for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
}

function lineArrays(gl, shader, outline) {
  const points = new Float32Array(bytes(outline.points)), shares = new Float32Array(bytes(outline.shares));
  const nodes = new Int32Array(bytes(outline.nodes)), pieces = new Int32Array(bytes(outline.pieces));
  const vertices = gl.createVertexArray();
  gl.bindVertexArray(vertices);
  const attribute = (name, array, length, end) => {
    const part = new array.constructor(length * pieces.length / 2);
    for (let piece = 0; piece < pieces.length / 2; piece++)
      for (let k = 0; k < length; k++) part[length * piece + k] = array[length * pieces[2 * piece + end] + k];
    const place = shader.attribute(name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, part, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribDivisor(place, 1);
    if (array instanceof Int32Array) gl.vertexAttribIPointer(place, length, gl.INT, 0, 0);
    else gl.vertexAttribPointer(place, length, gl.FLOAT, false, 0, 0);
  };
  ["from", "to"].forEach((name, end) => {
    attribute(name, points, 2, end);
    attribute(name + "Nodes", nodes, 3, end);
    attribute(name + "Shares", shares, 3, end);
  });
  gl.bindVertexArray(null);
  return { vertices, pieces: pieces.length / 2 };
}

// Orthographic view about the middle of the plate, from metres to the clip cube.
const camera = { azimuth: data.azimuth, elevation: data.elevation, zoom: 1 };
function view(canvas) {
  const [a, e] = [camera.azimuth, camera.elevation].map((degrees) => degrees * Math.PI / 180);
  const along = [-Math.sin(a), Math.cos(a), 0];
  const towards = [Math.cos(e) * along[1], -Math.cos(e) * along[0], Math.sin(e)];
  const up = [towards[1] * along[2] - towards[2] * along[1], towards[2] * along[0] - towards[0] * along[2],
    towards[0] * along[1] - towards[1] * along[0]];
  const [width, height] = data.size, middle = [width / 2, height / 2, 0];
  const reach = Math.hypot(width, height) / 2 / camera.zoom;
  const ratio = canvas.width / canvas.height, wide = Math.max(reach, 0.85 * reach * ratio);
  const rows = [[along, wide], [up, wide / ratio], [towards.map((part) => -part), 4 * Math.max(width, height)]];
  const matrix = new Float32Array(16);
  rows.forEach(([axis, half], row) => {
    for (let k = 0; k < 3; k++) {
      matrix[4 * k + row] = axis[k] / half;
      matrix[12 + row] -= axis[k] * middle[k] / half;
    }
  });
  matrix[15] = 1;
  return matrix;
}

class Plate {
  constructor(plate, index) {
    this.headings = plate.headings;
    const frame = document.createElement("div");
    this.heading = frame.appendChild(document.createElement("div"));
    this.heading.className = "heading";
    const row = frame.appendChild(document.createElement("div"));
    row.className = "row";
    this.canvas = row.appendChild(document.createElement("canvas"));
    this.factor = plate.factor;
    this.ownLegend = plate.legend !== null;
    if (this.ownLegend) {
      const legend = row.appendChild(document.createElement("div"));
      legend.className = "legend";
      for (const name of ["title", "bar"]) legend.append(part(byId("legend"), name).cloneNode(true));
      fillLegend(legend, plate.legend);
    }
    this.names = (plate.names ?? data.names).map(([text, x, y]) => {
      const label = row.appendChild(document.createElement("span"));
      return Object.assign(label, { className: "part", textContent: text, at: [x, y, 0, 1] });
    });
    this.canvas.setAttribute("aria-label", plate.headings[0]);
    byId("plates").append(frame);
    const gl = this.gl = this.canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser shows no WebGL 2");
    this.surface = program(gl, SURFACE, SURFACE_COLOUR);
    this.line = program(gl, LINE, LINE_COLOUR);
    this.heights = fieldTexture(gl, plate.heights, data.frames);
    this.colours = plate.colours === null ? this.heights : fieldTexture(gl, plate.colours, data.colourFrames);
    tableTexture(gl);
    this.triangles = new Uint32Array(bytes(data.triangles));
    this.nodes = gl.createVertexArray();
    gl.bindVertexArray(this.nodes);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(bytes(data.places)), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(this.surface.attribute("place"));
    gl.vertexAttribPointer(this.surface.attribute("place"), 2, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, this.triangles, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.outlines = (plate.outlines ?? data.outlines).map((outline) => ({ ...outline, ...lineArrays(gl, this.line, outline) }));
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    this.listen();
  }

  listen() {
    this.canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      camera.azimuth -= 0.4 * event.movementX;
      camera.elevation = Math.min(90, Math.max(-90, camera.elevation + 0.4 * event.movementY));
      ask();
    });
    this.canvas.addEventListener("pointerdown", (event) => this.canvas.setPointerCapture(event.pointerId));
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      camera.zoom *= Math.exp(-0.001 * event.deltaY);
      ask();
    }, { passive: false });
    this.canvas.addEventListener("dblclick", () => {
      Object.assign(camera, { azimuth: data.azimuth, elevation: data.elevation, zoom: 1 });
      ask();
    });
  }

  draw(now) {
    const gl = this.gl, canvas = this.canvas, ratio = window.devicePixelRatio || 1;
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
    gl.viewport(0, 0, wide, high);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const first = Math.floor(now) % data.frames, second = (first + 1) % data.frames;
    const matrix = view(canvas), colour = [first, second].map((frame) => frame % data.colourFrames);
    const common = (shader) => {
      shader.use();
      gl.uniform1i(shader.uniform("heights"), 0);
      gl.uniform1i(shader.uniform("colours"), 1);
      gl.uniformMatrix4fv(shader.uniform("view"), false, matrix);
      gl.uniform2i(shader.uniform("grid"), ...data.grid);
      gl.uniform4i(shader.uniform("frames"), first, second, ...colour);
      gl.uniform1f(shader.uniform("part"), now - Math.floor(now));
      gl.uniform1f(shader.uniform("tall"), data.peak * this.factor * factor());
    };
    [this.heights, this.colours].forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    });
    common(this.surface);
    gl.uniform1i(this.surface.uniform("table"), 2);
    gl.uniform2f(this.surface.uniform("limits"), ...data.limits);
    gl.uniform1i(this.surface.uniform("cyclic"), data.cyclic ? 1 : 0);
    gl.uniform3f(this.surface.uniform("none"), ...data.none);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(this.nodes);
    gl.drawElements(gl.TRIANGLES, this.triangles.length, gl.UNSIGNED_INT, 0);
    common(this.line);
    gl.uniform2f(this.line.uniform("pixels"), wide, high);
    gl.enable(gl.BLEND);
    // Lines cover each other in drawing order; only the surface hides them by depth.
    gl.depthMask(false);
    for (const outline of this.outlines) {
      gl.bindVertexArray(outline.vertices);
      gl.uniform4f(this.line.uniform("paint"), ...outline.colour);
      gl.uniform1f(this.line.uniform("width"), outline.width * ratio);
      gl.uniform1f(this.line.uniform("nearer"), outline.nearer);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, outline.pieces);
    }
    gl.depthMask(true);
    gl.bindVertexArray(null);
    for (const label of this.names) { // in front of the actuators, on the plate at rest
      const [x, y] = [0, 1].map((row) => label.at.reduce((sum, part, k) => sum + matrix[4 * k + row] * part, 0));
      label.style.left = `${canvas.clientWidth * (1 + x) / 2}px`;
      label.style.top = `${canvas.clientHeight * (1 - y) / 2 + 2}px`;
      label.hidden = Math.max(Math.abs(x), Math.abs(y)) > 1;
    }
    const heights = this.ownLegend && data.heightWords ? `, heights × ${short(this.factor * factor())}` : "";
    this.heading.textContent = this.headings[first] + heights;
  }
}

const player = { playing: true, frame: 0, last: null, asked: false };
const factor = () => Number((data.factor * 2 ** Number(byId("heights").value)).toPrecision(3));
// As short_number in fields.py: at most three digits, from 10000 on as 2.4·10⁷.
function short(value) {
  const [mantissa, exponent] = value.toExponential(2).split("e+");
  if (value < 1e4) return Number(value.toPrecision(3));
  return Number(mantissa) + "·10" + exponent.replace(/\d/g, (digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]);
}
function ask() {
  if (!player.asked) requestAnimationFrame(tick);
  player.asked = true;
}
function tick(moment) {
  player.asked = false;
  if (player.playing && player.last !== null) {
    const passed = (moment - player.last) / 1000 * data.rate * 2 ** Number(byId("speed").value);
    player.frame = (player.frame + passed) % data.frames;
    byId("time").value = player.frame;
  }
  player.last = player.playing ? moment : null;
  byId("factor").textContent = data.heightWords && data.title ? "× " + short(factor()) : "";
  for (const plate of plates) plate.draw(player.frame);
  if (player.playing) ask();
}
function play(on) {
  player.playing = on;
  byId("play").textContent = on ? "Pause" : "Play";
  ask();
}
function go(frame) {
  play(false);
  player.frame = ((frame % data.frames) + data.frames) % data.frames;
  byId("time").value = player.frame;
  ask();
}

const part = (parent, name) => parent.getElementsByClassName(name)[0];
function fillLegend(parent, legend) {
  part(parent, "title").textContent = legend.title;
  const context = part(parent, "colours").getContext("2d"), table = new Uint8Array(bytes(data.table));
  for (let row = 0; row < 256; row++) {
    context.fillStyle = `rgb(${table.slice(4 * row, 4 * row + 3).join(",")})`;
    context.fillRect(0, 255 - row, 1, 1);
  }
  const ticks = part(parent, "ticks");
  for (const tick of legend.ticks) ticks.append(Object.assign(document.createElement("span"), { textContent: tick }));
}
function legend() {
  byId("name").textContent = document.title = data.name;
  if (data.thinned) byId("hint").append(" " + data.thinned);
  if (data.title) fillLegend(byId("legend"), data);
  else part(byId("legend"), "bar").hidden = true;
  for (const [text, colour] of data.key) {
    const line = byId("key").appendChild(document.createElement("div"));
    line.textContent = text;
    line.style.color = colour;
  }
}

byId("time").max = data.frames - 0.001;
byId("plates").style.gridTemplateColumns = `repeat(${data.columns}, minmax(0, 1fr))`;
const plates = data.plates.map((plate, index) => new Plate(plate, index));
legend();
byId("play").addEventListener("click", () => play(!player.playing));
byId("time").addEventListener("input", (event) => go(Number(event.target.value)));
for (const id of ["heights", "speed"]) byId(id).addEventListener("input", ask);
window.addEventListener("resize", ask);
document.addEventListener("keydown", (event) => {
  const keys = { " ": () => play(!player.playing), ArrowRight: () => go(Math.floor(player.frame) + 1),
    ArrowLeft: () => go(Math.ceil(player.frame) - 1) };
  if (!(event.key in keys)) return;
  event.preventDefault();
  document.activeElement.blur();
  keys[event.key]();
});
ask();
