"use strict";
/* The parts in three dimensions: plain WebGL, nothing loaded. Drag or arrow keys turn, + and − zoom, 0 starts again. */
(function () {
  const box = document.getElementById("solid");
  if (!box) return;
  const canvas = box.querySelector("canvas");
  const gl = canvas.getContext("webgl", { antialias: true, alpha: false, preserveDrawingBuffer: true });
  if (!gl) { box.dataset.state = "no WebGL: the picture is shown instead"; return; }

  function bytes(text) {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }
  const store = box.querySelector("[data-parts]").dataset;
  const facts = JSON.parse(store.facts);
  const data = bytes(store.parts);

  const program = webgl.program(gl,
    "attribute vec3 place; attribute vec3 normal; uniform mat4 view; uniform mat3 turn; uniform float slide;" +
    "varying vec3 n; varying float cut;" +
    "void main() { n = turn * normal; cut = place.y; gl_Position = view * vec4(place + vec3(0.0, 0.0, slide), 1.0); }",
    "precision mediump float; varying vec3 n; varying float cut; uniform vec3 colour; uniform float keep; uniform float lit;" +
    "uniform vec3 from; uniform vec3 power;" +
    "void main() { if (cut > keep) discard; vec3 m = normalize(n); if (!gl_FrontFacing) m = -m;" +
    "float d = power.x + power.y * max(dot(m, normalize(from)), 0.0) + power.z * pow(max(m.z, 0.0), 8.0);" +
    "gl_FragColor = vec4(mix(colour, colour * d, lit) * (gl_FrontFacing || lit < 0.5 ? 1.0 : 0.72), 1.0); }");
  gl.useProgram(program);
  const at = webgl.places(gl, program, ["view", "turn", "slide", "colour", "keep", "lit", "from", "power"]);
  const place = gl.getAttribLocation(program, "place"), normal = gl.getAttribLocation(program, "normal");

  function buffer(kind, values) {
    const b = gl.createBuffer();
    gl.bindBuffer(kind, b); gl.bufferData(kind, values, gl.STATIC_DRAW);
    return b;
  }
  const parts = facts.bodies.map(function (body) {
    return {
      colour: body.colour, number: body.number, count: body.triangles * 3,
      place: buffer(gl.ARRAY_BUFFER, new Int16Array(data, body.place, body.vertices * 4)),
      normal: buffer(gl.ARRAY_BUFFER, new Int8Array(data, body.normal, body.vertices * 4)),
      index: buffer(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(data, body.index, body.triangles * 3)),
    };
  });
  const rays = facts.rays.map(function (ray) {
    return { count: ray.length / 3, place: buffer(gl.ARRAY_BUFFER, new Float32Array(ray)) };
  });

  const start = { yaw: facts.view[0], pitch: facts.view[1], zoom: 1.0, gap: facts.gap.shown, cut: false, rays: true };
  let state = Object.assign({}, start), waiting = false;

  function multiply(a, b) { // 3 × 3, rows
    const out = [];
    for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++)
      out.push(a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j]);
    return out;
  }
  function draw() {
    waiting = false;
    const [wide, tall] = webgl.fit(canvas);
    gl.viewport(0, 0, wide, tall);
    const dark = window.matchMedia && window.matchMedia("(prefers-color-scheme: dark)").matches;
    const paper = dark ? [0.08, 0.1, 0.12] : [0.97, 0.98, 0.99];
    gl.clearColor(paper[0], paper[1], paper[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const cy = Math.cos(state.yaw), sy = Math.sin(state.yaw), cp = Math.cos(state.pitch), sp = Math.sin(state.pitch);
    // z of the sheet to the right, x up at the start: light comes from the left, as in the drawings
    const basis = [0, 0, 1, 1, 0, 0, 0, 1, 0];
    const turn = multiply([1, 0, 0, 0, cp, -sp, 0, sp, cp], multiply([cy, 0, sy, 0, 1, 0, -sy, 0, cy], basis));
    const shift = state.gap - facts.gap.built; // lens 2 is moved by this; 0 as built
    const depth = facts.size[2] + shift;
    const reach = 0.4 * Math.hypot(facts.size[0], facts.size[1], depth) / state.zoom;
    const fit = Math.min(1, wide / tall), sx = fit * tall / wide / reach, sz = fit / reach;
    const middle = facts.middle[2] + 0.5 * shift;
    const view = new Float32Array(16);
    const centre = [facts.middle[0], facts.middle[1], middle];
    for (let i = 0; i < 3; i++) {
      const s = i === 0 ? sx : i === 1 ? sz : -0.25 / (reach * state.zoom);
      for (let j = 0; j < 3; j++) view[4 * j + i] = s * turn[3 * i + j];
      view[12 + i] = -s * (turn[3 * i] * centre[0] + turn[3 * i + 1] * centre[1] + turn[3 * i + 2] * centre[2]);
    }
    view[15] = 1;
    const unit = facts.unit, scaled = new Float32Array(view);
    for (let j = 0; j < 12; j++) scaled[j] *= unit;
    gl.uniformMatrix3fv(at.turn, false, new Float32Array([turn[0], turn[3], turn[6], turn[1], turn[4], turn[7], turn[2], turn[5], turn[8]]));
    gl.uniform1f(at.keep, state.cut ? facts.cut / unit : 1e9);
    gl.uniformMatrix4fv(at.view, false, scaled);
    gl.uniform1f(at.lit, 1);
    gl.uniform3fv(at.from, facts.light.slice(0, 3)); gl.uniform3fv(at.power, facts.light.slice(3));
    gl.enableVertexAttribArray(place); gl.enableVertexAttribArray(normal);
    for (const part of parts) {
      gl.uniform1f(at.slide, part.number > 0 ? shift / unit : 0);
      gl.uniform3fv(at.colour, part.colour);
      gl.bindBuffer(gl.ARRAY_BUFFER, part.place); gl.vertexAttribPointer(place, 3, gl.SHORT, false, 8, 0);
      gl.bindBuffer(gl.ARRAY_BUFFER, part.normal); gl.vertexAttribPointer(normal, 3, gl.BYTE, true, 4, 0);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.index); gl.drawElements(gl.TRIANGLES, part.count, gl.UNSIGNED_SHORT, 0);
    }
    if (state.rays && Math.abs(shift) < 1e-9 * facts.size[2]) { // rays are those of the part as built
      gl.disableVertexAttribArray(normal); gl.vertexAttrib3f(normal, 0, 0, 1);
      gl.uniformMatrix4fv(at.view, false, view); gl.uniform1f(at.keep, 1e9); gl.uniform1f(at.lit, 0); gl.uniform1f(at.slide, 0);
      gl.uniform3fv(at.colour, dark ? [1.0, 0.55, 0.3] : [0.76, 0.34, 0.1]);
      for (const ray of rays) {
        gl.bindBuffer(gl.ARRAY_BUFFER, ray.place); gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 12, 0);
        gl.drawArrays(gl.LINE_STRIP, 0, ray.count);
      }
    }
    box.dataset.state = "drawn";
    box.dataset.view = state.yaw.toFixed(4) + " " + state.pitch.toFixed(4) + " " + state.zoom.toFixed(4);
  }
  function again() { if (!waiting) { waiting = true; window.requestAnimationFrame(draw); } }
  function zoom(by) { state.zoom = Math.min(20, Math.max(0.3, state.zoom * by)); again(); }
  function turnBy(dx, dy) {
    state.yaw += dx; state.pitch = Math.min(1.57, Math.max(-1.57, state.pitch + dy)); again();
  }

  webgl.handle(canvas, {
    moved: function (dx, dy) { turnBy(0.008 * dx, 0.008 * dy); }, zoomed: zoom, reset: reset,
  });
  const controls = box.querySelector("[data-controls]");
  const cut = controls.querySelector("[name=cut]"), lines = controls.querySelector("[name=rays]"), gap = controls.querySelector("[name=gap]");
  function reset() {
    state = Object.assign({}, start);
    cut.checked = state.cut; lines.checked = state.rays;
    if (gap) gap.value = String(Math.round(1000 * state.gap / facts.gap.built));
    again();
  }
  cut.addEventListener("change", function () { state.cut = cut.checked; again(); });
  lines.addEventListener("change", function () { state.rays = lines.checked; again(); });
  if (gap) gap.addEventListener("input", function () { state.gap = facts.gap.built * Number(gap.value) / 1000; again(); });
  controls.querySelector("[name=reset]").addEventListener("click", reset);
  window.addEventListener("resize", again);
  if (window.matchMedia) {
    const scheme = window.matchMedia("(prefers-color-scheme: dark)");
    if (scheme.addEventListener) scheme.addEventListener("change", again);
  }
  canvas.hidden = false; controls.hidden = false;
  box.classList.add("live");
  reset();
})();
