/* The page's controls and its view: state of the sliders, picture, verdict, TOML, link. */
(function () {
  const page = document.getElementById("explorer"), facts = JSON.parse(page.dataset.facts);
  const canvas = page.querySelector("canvas"), verdictLine = page.querySelector("[data-verdict]");
  const tomlBox = page.querySelector("[name=toml]"), told = page.querySelector("[data-told]");
  const sliders = {}, switches = ["field", "ghosts", "colour"];
  for (const s of facts.sliders) sliders[s.id] = s;
  const LEAST_ETA = 0.01, REST = 160; // milliseconds without a change after which the picture is drawn finely
  const FINE = 12; // rays a pixel of it
  const PHOTO = 1024; // most pixels a side of the reader's photograph
  const LIVE = 50; // milliseconds that a picture may take while something moves; else it is drawn coarser
  let state = {}, made = null;

  function started() {
    const out = { field: facts.field ? 1 : 0, ghosts: 1, colour: 0 };
    for (const s of facts.sliders) out[s.id] = s.start;
    return out;
  }
  function allowed(id, value) {
    if (switches.includes(id)) return value ? 1 : 0;
    const s = sliders[id];
    if (typeof value !== "number" || !isFinite(value)) return state[id];
    value = Math.min(s.high, Math.max(s.low, value));
    if (id.startsWith("eta") && Math.abs(value) < LEAST_ETA) value = value < 0 ? -LEAST_ETA : LEAST_ETA;
    return value;
  }
  function nested(flat) {
    return {
      eta: [flat.eta_x, flat.eta_y], delta: [flat.delta_x, flat.delta_y], euler: [flat.phi, flat.theta, flat.psi],
      pitch: flat.pitch, separation: flat.separation, object: flat.object, eye: flat.eye, azimuth: flat.azimuth,
      elevation: flat.elevation, fov: flat.fov, field: flat.field, ghosts: flat.ghosts, colour: flat.colour,
    };
  }
  function set(changes) {
    for (const id of Object.keys(changes)) if (id in sliders || switches.includes(id)) state[id] = allowed(id, changes[id]);
    made = closedForms.sheet(facts, nested(state));
    show(); draw();
  }

  // -- texts of the page -------------------------------------------------------------------------------
  function digits(v) { return isFinite(v) ? String(Number(v.toPrecision(3))) : "unlimited"; }
  function degrees(t) { return digits(Math.atan(t) * 180 / Math.PI) + "\u00b0"; }
  function length(units) {
    const m = units * facts.unitM;
    if (!isFinite(m)) return "any";
    return m >= 1 ? digits(m) + " m" : m >= 1e-3 ? digits(m * 1e3) + " mm" : digits(m * 1e6) + " \u00b5m";
  }
  function both(pair, written) {
    const [x, y] = pair.map(written);
    return x === y ? x : x + " in x, " + y + " in y";
  }
  function sentence(v) {
    const plusMinus = function (t) { return (t === 0 ? "" : "\u00b1") + degrees(t); };
    return "Light to the partner lens: " + digits(100 * v.share) + " % along the middle of the field, "
      + digits(100 * v.share_from_eye) + " % over the sheet from this eye. Ghosts from " + both(v.ghost_onset, plusMinus)
      + "; field " + both(v.half_field, plusMinus) + ". Sharpest pitch for an object " + length(state.object)
      + " behind: " + length(v.advised_pitch) + " (this one: " + length(state.pitch) + ").";
  }
  function toml() {
    const values = {
      eta: [state.eta_x, state.eta_y], delta: [0, 1].map(function (k) { return made.power1[k] === 0 ? 0 : [state.delta_x, state.delta_y][k]; }),
      euler: [state.phi, state.theta, state.psi], separation: state.separation, pitch: made.pitch, count: made.count,
      viewer: state.eye, object: state.object,
    };
    const ids = { eta: ["eta_x", "eta_y"], delta: ["delta_x", "delta_y"], euler: ["phi", "theta", "psi"], count: ["pitch"], viewer: ["eye"] };
    const lines = [], wrong = closedForms.unbuildable(made);
    if (wrong) lines.push("# cannot be made: " + wrong);
    const on = Boolean(closedForms.fieldLens(made)), start = started();
    const derived = facts.given && ["eta_x", "eta_y", "delta_x", "delta_y", "separation", "field"].some(function (id) { return state[id] !== start[id]; });
    if (derived) lines.push("# the faces that were given were for another law or separation: they are derived here");
    let section = "";
    for (const line of facts.toml) {
      if (typeof line === "string") {
        if (line === "" && section === "[pair]" && on && !facts.field) lines.push("field_lens = true");
        if (line.startsWith("[")) section = line;
        const key = section === "[pair]" ? line.split(" = ")[0] : "";
        if (!on && ["field_lens", "field"].includes(key) || derived && ["prescription", "face", "search", "vertex"].includes(key)) continue;
        lines.push(line);
        continue;
      }
      const touched = (ids[line.key] || [line.key]).some(function (id) { return state[id] !== sliders[id].start; })
        || (line.key === "delta" && values.delta.some(function (v, k) { return v !== [state.delta_x, state.delta_y][k]; }));
      if (!touched) { if (line.start !== null) lines.push(line.start); continue; }
      const v = values[line.key];
      lines.push(line.as + (line.metres ? '"' + v * facts.unitM + ' m"' : Array.isArray(v)
        ? (line.single ? String(v[0]) : "[" + v.join(", ") + "]") : String(v)));
    }
    return lines.join("\n") + "\n";
  }
  function fragment() {
    const start = started();
    return Object.keys(start).filter(function (id) { return state[id] !== start[id]; })
      .map(function (id) { return id + "=" + state[id]; }).join("&");
  }
  function fromFragment() {
    const changes = {};
    for (const part of window.location.hash.slice(1).split("&")) {
      const [id, text] = part.split("=");
      if (text !== undefined && text !== "" && isFinite(Number(text))) changes[id] = Number(text);
    }
    return changes;
  }

  function place(s) { // of a slider's handle
    if (!s.log) return state[s.id];
    return Math.round(1000 * Math.log(state[s.id] / s.low) / Math.log(s.high / s.low));
  }
  function valueAt(s, at) {
    return Number((s.log ? s.low * Math.pow(s.high / s.low, at / 1000) : at).toPrecision(4));
  }
  function show() {
    for (const s of facts.sliders) {
      const handle = page.querySelector("[data-slide=" + s.id + "]"), field = page.querySelector("[name=" + s.id + "]");
      handle.value = String(place(s));
      handle.setAttribute("aria-valuetext", digits(state[s.id]) + " " + s.unit);
      if (document.activeElement !== field) field.value = String(Number(state[s.id].toPrecision(6)));
    }
    for (const id of switches) page.querySelector("[name=" + id + "]").checked = Boolean(state[id]);
    const why = closedForms.noFieldLens(made), box = page.querySelector("[name=field]");
    box.disabled = why !== "";
    page.querySelector("[name=colour]").disabled = !facts.colours;
    page.querySelector("[data-no-colour]").textContent = facts.colours ? "" : " (the index is not known at the wavelengths of red, green and blue)";
    page.querySelector("[data-why]").textContent = why === "" ? "" : " (" + why + ")";
    const wrong = closedForms.unbuildable(made);
    verdictLine.textContent = (wrong ? "Cannot be made: " + wrong + ". " : "") + sentence(closedForms.verdict(made));
    verdictLine.classList.toggle("wrong", wrong !== "");
    tomlBox.value = toml();
    page.querySelector("[name=copy-toml]").disabled = wrong !== "";
    const changed = fragment();
    try { window.history.replaceState(null, "", changed ? "#" + changed : window.location.pathname + window.location.search); }
    catch (e) { if (changed) window.location.hash = changed; }
  }

  // -- the picture -----------------------------------------------------------------------------------
  const gl = canvas.getContext("webgl", { antialias: false, alpha: false, preserveDrawingBuffer: true });
  const precise = gl && gl.getShaderPrecisionFormat(gl.FRAGMENT_SHADER, gl.HIGH_FLOAT).precision >= 23;
  const NAMES = ["size", "eye", "ahead", "right", "up", "count", "pitch", "firstCentre", "kept", "solid", "solidCentre", "turn",
    "power1", "power2", "apex2", "wholeSteps", "residual", "drift", "fieldGrow", "span", "margin", "opaque", "baffle", "fieldFocus",
    "fieldPower", "fieldCentre", "objectAt", "card", "ghosts", "stronger", "part", "photo", "photoHalf"];
  let photoHalf = null; // half sides of the reader's photograph over the card's; null: the card with an F
  const programs = {};
  function program(kind, wide, tall) { // "view", "fine" or "debug" for what the sheet has now, compiled when first used
    const out = outlines(), has = {
      HEX: made.hexagonal, TILTED: state.theta !== 0, FIELD: closedForms.fieldLens(made), AIMED: made.drift !== 0, BAFFLE: facts.baffle !== null,
      OUTLINE: out.kept[0] > 0, SEAM: facts.seam > 0, BODY: out.solid[0] > 0, BEHIND: looksAway(camera(wide, tall)), COLOUR: Boolean(facts.colours && state.colour), DEBUG: kind === "debug", PHOTO: photoHalf !== null,
    };
    const head = Object.keys(has).filter(function (name) { return has[name]; }).map(function (name) { return "#define " + name + "\n"; }).join("")
      + "#define SAMPLES " + (kind === "fine" ? FINE : 1) + "\n";
    if (!programs[head]) {
      const linked = webgl.program(gl, "attribute vec2 corner; void main() { gl_Position = vec4(corner, 0.0, 1.0); }",
        head + document.getElementById("shader").textContent);
      programs[head] = { program: linked, at: webgl.places(gl, linked, NAMES) };
    }
    return programs[head];
  }
  function looksAway(view) { // whether a corner of the picture does; its pixels lie between them
    return view.ahead[2] - Math.abs(view.right[2]) - Math.abs(view.up[2]) <= 0;
  }
  function camera(wide, tall) { // eye, and directions to the middle and to the borders of the picture, sheet frame
    const eye = closedForms.eyePlace(nested(state)), far = Math.hypot(eye[0], eye[1], eye[2]);
    const a = eye.map(function (v) { return -v / far; });
    const level = Math.hypot(a[0], a[2]), t = Math.tan(state.fov * Math.PI / 360);
    const right = [-a[2] / level, 0, a[0] / level]; // ahead x (0, 1, 0)
    const up = [right[1] * a[2] - right[2] * a[1], right[2] * a[0] - right[0] * a[2], right[0] * a[1] - right[1] * a[0]];
    const least = Math.min(wide, tall); // the angle of view is that of the shorter side
    return { eye: eye, ahead: a, right: right.map(function (v) { return v * t * wide / least; }), up: up.map(function (v) { return v * t * tall / least; }) };
  }
  function relocated(p) { // whole steps of array 2 and rest of a displacement, in pitches
    const grow = 1 + made.drift, over = p.map(function (v) { return v / grow; });
    const best = closedForms.relocated(made.hexagonal, made.pitch[1] / made.pitch[0], over);
    return { steps: best.steps, rest: best.rest.map(function (v) { return v * grow; }) };
  }
  function heights(apex, drift) { // lowest and highest point of an array's patches over their cells, in pitches
    const axis = closedForms.toSheet(made.turn, [0, 0, 1]), p = made.pitch[0], grow = 1 + drift;
    const z = made.tile.map(function (c) {
      return -((grow * c[0] / p - apex[0]) * axis[0] + (grow * c[1] / p - apex[1]) * axis[1]) / axis[2] || 0;
    });
    const far = Math.abs(drift) * (Math.abs(made.first[0] * axis[0]) + Math.abs(made.first[1] * axis[1])) / p / Math.abs(axis[2]);
    return [Math.min.apply(null, z) - far, Math.max.apply(null, z) + far];
  }
  function outlines() { // of the cells, and of the bodies: kind and half sizes in pitches
    const p = made.pitch[0], o = facts.outline, slip = facts.form === "slab" ? made.solidShift : [0, 0];
    const wider = Math.max(1, 1 + made.solidDrift);
    if (o) {
      const round = o[0] === "circle", whole = round ? [o[1], o[1]] : [o[1], o[2]];
      const off = round ? [2 * Math.hypot(slip[0], slip[1]), 0] : [2 * Math.abs(slip[0]), 2 * Math.abs(slip[1])];
      const half = whole.map(function (v) { return v / 2 / p + facts.border / p; });
      const kept = whole.map(function (v, k) { return Math.max(0, v - (round ? off[0] : off[k])) / wider / 2 / p * (1 + 1e-6); });
      return { kept: [round ? 1 : 2, kept[0], kept[1]], solid: [round ? 1 : 2, half[0], half[1]] };
    }
    if (facts.border === 0 && !(slip[0] || slip[1] || facts.aim && facts.form === "slab")) return { kept: [0, 0, 0], solid: [0, 0, 0] };
    const first = made.first.map(function (v) { return v / p; }), n = made.count, hex = made.hexagonal;
    const high = [first[0] + n[0] - 1 + (hex && n[1] > 1 ? 0.5 : 0) + 0.5, hex ? -first[1] + 1 / Math.sqrt(3) : n[1] * made.pitch[1] / p / 2];
    const reach = [Math.max(0.5 - first[0], high[0]), high[1]].map(function (v, k) { return v * wider + facts.border / p + Math.abs(slip[k]) / p; });
    return { kept: [0, 0, 0], solid: [2, reach[0], reach[1]] };
  }
  function uniforms(wide, tall, part) {
    const p = made.pitch[0], m = made.turn, view = camera(wide, tall), out = outlines(), moved = relocated(made.shift.map(function (v) { return v / p; }));
    const over = function (v) { return v.map(function (x) { return x / p; }); };
    const apex = over([made.offset[0] - made.shift[0], made.offset[1] - made.shift[1], made.offset[2]]);
    const on = closedForms.fieldLens(made), f1 = made.power1.map(function (v) { return on ? 1 / (v * p) : 0; });
    const q = f1.map(function (f) { return made.shift.map(function (v) { return v / made.s * f; }); });
    return {
      size: [wide, tall], eye: over(view.eye), ahead: view.ahead, right: view.right, up: view.up, count: made.count,
      pitch: [1, made.hexagonal ? Math.sqrt(3) / 2 : made.pitch[1] / p], firstCentre: over(made.first), kept: out.kept, solid: out.solid,
      solidCentre: facts.form === "slab" ? [0, 0] : over(made.shift),
      turn: [m[0][0], m[1][0], m[2][0], m[0][1], m[1][1], m[2][1], m[0][2], m[1][2], m[2][2]],
      power1: made.power1.map(function (v) { return v * p; }), power2: made.power2.map(function (v) { return v * p; }),
      apex2: apex, wholeSteps: moved.steps, residual: moved.rest, drift: made.drift, fieldGrow: on ? closedForms.fieldGrow(made) : [1, 1],
      span: heights([0, 0], 0).concat(heights(apex, made.drift)),
      margin: facts.seam / 2 / p, opaque: facts.opaque ? 1 : 0, baffle: (facts.baffle || 0) / 2 / p,
      fieldFocus: f1, fieldPower: [0, 1].map(function (k) { return (made.power1[k] + made.power2[k]) * p; }),
      fieldCentre: q[0].concat(q[1]), objectAt: (made.offset[2] + state.object) / p, card: facts.card / p,
      ghosts: state.ghosts, stronger: facts.colours || [1, 1, 1], part: part, photo: 1, photoHalf: photoHalf || [1, 1],
    };
  }
  function render(kind, wide, tall, part) {
    const used = program(kind, wide, tall), u = uniforms(wide, tall, part || 0);
    gl.useProgram(used.program);
    for (const name of NAMES) {
      const v = u[name], at = used.at[name];
      if (at === null) continue;
      if (name === "photo") gl.uniform1i(at, v); // unit 1
      else if (name === "turn") gl.uniformMatrix3fv(at, false, v);
      else if (typeof v === "number") gl.uniform1f(at, v);
      else gl["uniform" + v.length + "fv"](at, v);
    }
    gl.viewport(0, 0, wide, tall);
    const corner = gl.getAttribLocation(used.program, "corner");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
  function aside(wide, tall, act) { // act() draws into a picture of its own size; gives its bytes, lowest row first
    const texture = gl.createTexture(), frame = gl.createFramebuffer();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, wide, tall, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    const bytes = new Uint8Array(4 * wide * tall);
    act(function () { gl.readPixels(0, 0, wide, tall, gl.RGBA, gl.UNSIGNED_BYTE, bytes); });
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame); gl.deleteTexture(texture);
    let text = "";
    for (let k = 0; k < bytes.length; k += 8192) text += String.fromCharCode.apply(null, bytes.subarray(k, k + 8192));
    return btoa(text);
  }
  let frame = 0, resting = 0, coarser = 1;
  const one = new Uint8Array(4);
  function drawNow(kind) {
    window.cancelAnimationFrame(frame); // a frame that comes late does not replace the fine picture
    frame = 0;
    const began = performance.now(), [wide, tall] = webgl.fit(canvas, kind === "fine" ? 1 : coarser);
    render(kind, wide, tall, 0);
    if (kind === "view") {
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, one); // waits until it is drawn
      const took = performance.now() - began;
      coarser = took > LIVE ? Math.min(4, 1.4 * coarser) : took < 0.3 * LIVE ? Math.max(1, coarser / 1.4) : coarser;
    }
    page.dataset.state = kind === "fine" ? "fine" : "drawn";
  }
  function draw() {
    if (!precise) return;
    page.dataset.state = "changed";
    window.clearTimeout(resting);
    if (!frame) frame = window.requestAnimationFrame(function () { drawNow("view"); });
    resting = window.setTimeout(function () { drawNow("fine"); }, REST);
  }

  // -- hands -----------------------------------------------------------------------------------------
  for (const s of facts.sliders) {
    const handle = page.querySelector("[data-slide=" + s.id + "]"), field = page.querySelector("[name=" + s.id + "]");
    handle.addEventListener("input", function () { set({ [s.id]: valueAt(s, Number(handle.value)) }); });
    field.addEventListener("input", function () { if (field.value !== "" && field.checkValidity()) set({ [s.id]: Number(field.value) }); });
    field.addEventListener("blur", show);
  }
  for (const id of switches) page.querySelector("[name=" + id + "]").addEventListener("change", function (e) { set({ [id]: e.target.checked ? 1 : 0 }); });
  function reset() { page.querySelector("[name=preset]").value = "0"; state = started(); set({}); say("As designed again."); }
  function say(text) { told.textContent = text; }
  function copy(text, what) {
    function byHand() { tomlBox.closest("details").open = true; tomlBox.select(); say("Copying is not allowed here: the text is selected, copy it by hand."); }
    if (navigator.clipboard && window.isSecureContext) navigator.clipboard.writeText(text).then(function () { say(what + " copied."); }, byHand);
    else byHand();
  }
  page.querySelector("[name=reset]").addEventListener("click", reset);
  page.querySelector("[name=copy-toml]").addEventListener("click", function () { copy(tomlBox.value, "Design file"); });
  page.querySelector("[name=copy-link]").addEventListener("click", function () { copy(window.location.href, "Link"); });
  page.querySelector("[name=preset]").addEventListener("change", function (e) {
    state = started(); set(facts.presets[Number(e.target.value)][1]); say("");
  });
  const chosen = page.querySelector("[name=photo]"), card = page.querySelector("[name=card]");
  function lookAt(bitmap) { // show a picture of at most PHOTO pixels a side in place of the card; null: the card
    card.disabled = bitmap === null;
    photoHalf = null;
    if (bitmap !== null) {
      const most = Math.max(bitmap.width, bitmap.height), small = Math.min(1, PHOTO / most), copied = document.createElement("canvas");
      copied.width = Math.max(1, Math.round(bitmap.width * small));
      copied.height = Math.max(1, Math.round(bitmap.height * small));
      copied.getContext("2d").drawImage(bitmap, 0, 0, copied.width, copied.height);
      gl.activeTexture(gl.TEXTURE1);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, true);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, copied);
      for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.activeTexture(gl.TEXTURE0);
      photoHalf = [bitmap.width / most, bitmap.height / most];
    }
    draw();
  }
  function opened(file) {
    return createImageBitmap(file).then(function (bitmap) { lookAt(bitmap); say("Your photograph is behind the sheet. It stays in this page."); },
      function () { say("This file is no picture that the browser reads."); });
  }
  chosen.addEventListener("change", function () { if (chosen.files.length) opened(chosen.files[0]); });
  card.addEventListener("click", function () { chosen.value = ""; lookAt(null); say("The card is behind the sheet again."); chosen.focus(); });
  chosen.disabled = !precise;
  function turned(dx, dy) { set({ azimuth: state.azimuth + 0.2 * dx, elevation: state.elevation + 0.2 * dy }); }
  function zoomed(by) { set({ fov: state.fov / by }); }
  webgl.handle(canvas, { moved: turned, zoomed: zoomed, reset: reset });
  window.addEventListener("resize", draw);
  window.addEventListener("hashchange", function () { if (window.location.hash.slice(1) !== fragment()) { state = started(); set(fromFragment()); } });

  if (precise) {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    canvas.hidden = false;
  } else {
    page.dataset.state = "no WebGL";
    page.querySelector("[data-no-view]").hidden = false;
  }
  state = started();
  set(fromFragment());

  window.explorer = { // for those who measure the page
    set: set, reset: reset, photo: opened, state: function () { return Object.assign({}, state); }, toml: toml, camera: camera,
    verdict: function () { return closedForms.verdict(made); },
    debug: function (part, wide, tall) { return aside(wide, tall, function (read) { render("debug", wide, tall, part); read(); }); },
    picture: function (wide, tall) { return aside(wide, tall, function (read) { render("fine", wide, tall, 0); read(); }); },
    times: function (size, frames) { // milliseconds of each frame
      const found = [];
      aside(size, size, function () {
        for (let k = 0; k < frames; k++) {
          const began = performance.now();
          render("view", size, size, 0);
          gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, one); // waits until it is drawn
          found.push(performance.now() - began);
        }
      });
      return found;
    },
  };
})();
