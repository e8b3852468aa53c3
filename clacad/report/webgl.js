"use strict";
/* What the views of our pages share: compiling, sizing, dragging. Plain WebGL 1. */
const webgl = (function () {
  function shader(gl, kind, text) {
    const s = gl.createShader(kind);
    gl.shaderSource(s, text); gl.compileShader(s);
    if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
    return s;
  }
  function program(gl, vertex, fragment) {
    const p = gl.createProgram();
    gl.attachShader(p, shader(gl, gl.VERTEX_SHADER, vertex));
    gl.attachShader(p, shader(gl, gl.FRAGMENT_SHADER, fragment));
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
    return p;
  }
  function places(gl, p, names) {
    const at = {};
    for (const name of names) at[name] = gl.getUniformLocation(p, name);
    return at;
  }
  function fit(canvas, coarser) { // the canvas as many pixels as it is shown on, at most two a length of the page, or fewer by a factor
    const ratio = Math.min(window.devicePixelRatio || 1, 2) / (coarser || 1);
    const wide = Math.max(1, Math.round(canvas.clientWidth * ratio)), tall = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== wide || canvas.height !== tall) { canvas.width = wide; canvas.height = tall; }
    return [wide, tall];
  }
  /* Drags of one finger or the mouse as moved(dx, dy), of two as zoomed(ratio); the wheel and + - 0 and arrows too. */
  function handle(canvas, act) {
    const held = new Map();
    function spread() {
      const [a, b] = [...held.values()];
      return Math.max(1, Math.hypot(a[0] - b[0], a[1] - b[1]));
    }
    canvas.addEventListener("pointerdown", function (e) { held.set(e.pointerId, [e.clientX, e.clientY]); canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointermove", function (e) {
      const last = held.get(e.pointerId);
      if (!last) return;
      const before = held.size === 2 ? spread() : 0;
      held.set(e.pointerId, [e.clientX, e.clientY]);
      if (held.size === 1) act.moved(e.clientX - last[0], e.clientY - last[1]);
      else if (held.size === 2) act.zoomed(spread() / before);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, function (e) { held.delete(e.pointerId); });
    canvas.addEventListener("wheel", function (e) {
      if (document.activeElement !== canvas) return; // the page scrolls until the view has been chosen
      e.preventDefault(); act.zoomed(Math.exp(-0.0015 * e.deltaY));
    }, { passive: false });
    canvas.addEventListener("keydown", function (e) {
      const way = { ArrowLeft: [-15, 0], ArrowRight: [15, 0], ArrowUp: [0, -15], ArrowDown: [0, 15] }[e.key];
      if (way) act.moved(way[0], way[1]);
      else if (e.key === "+" || e.key === "=") act.zoomed(1.15);
      else if (e.key === "-") act.zoomed(1 / 1.15);
      else if (e.key === "0") act.reset();
      else return;
      e.preventDefault();
    });
  }
  return { program: program, places: places, fit: fit, handle: handle };
})();
