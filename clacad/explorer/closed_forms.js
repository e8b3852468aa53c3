/* Closed forms of the thin pair: the numbers of clacad/sheet/vignetting.py and clacad/sheet/feasibility.
   Lengths in units of the design, angles in degrees, wavelengths in metres. A sheet is made of facts (of the design)
   and a state (of the sliders). */
const closedForms = (function () {
  function cosSin(degrees) { // exact at quarter turns
    const within = degrees % 360, turns = Math.round(within / 90), rest = (within - 90 * turns) * Math.PI / 180;
    const c = Math.cos(rest), s = Math.sin(rest);
    return [[c, s], [-s, c], [-c, -s], [s, -c]][((turns % 4) + 4) % 4];
  }
  function rotation(euler, axes) { // rows; lens to sheet
    const phi = axes === "moving" ? euler[2] : euler[0], psi = axes === "moving" ? euler[0] : euler[2];
    const [ct, st] = cosSin(euler[1]);
    if (st === 0) {
      const [c, s] = cosSin(phi + ct * psi);
      return [[c, -s, 0], [ct * s, ct * c, 0], [0, 0, ct]];
    }
    const [cf, sf] = cosSin(phi), [cp, sp] = cosSin(psi);
    return [[cp * cf - sp * ct * sf, -cp * sf - sp * ct * cf, sp * st],
      [sp * cf + cp * ct * sf, -sp * sf + cp * ct * cf, -cp * st], [st * sf, st * cf, ct]];
  }
  function toSheet(m, v) { return m.map(function (row) { return row[0] * v[0] + row[1] * v[1] + row[2] * v[2]; }); }
  function toLens(m, v) { return [0, 1, 2].map(function (k) { return m[0][k] * v[0] + m[1][k] * v[1] + m[2][k] * v[2]; }); }

  function tileOf(facts, pitch) {
    const p = pitch[0], e = p / Math.sqrt(3);
    if (facts.kind === "hexagonal") return [[p / 2, -e / 2], [p / 2, e / 2], [0, e], [-p / 2, e / 2], [-p / 2, -e / 2], [0, -e]];
    return [[p / 2, -pitch[1] / 2], [p / 2, pitch[1] / 2], [-p / 2, pitch[1] / 2], [-p / 2, -pitch[1] / 2]];
  }
  function less(tile, pitch, seam, hexagonal) {
    const fx = 1 - seam / pitch[0], fy = hexagonal ? fx : 1 - seam / pitch[1];
    return tile.map(function (c) { return [c[0] * fx, c[1] * fy]; });
  }
  function area(polygon) {
    let sum = 0;
    for (let k = 0; k < polygon.length; k++) {
      const a = polygon[k], b = polygon[(k + 1) % polygon.length];
      sum += (a[0] - polygon[0][0]) * (b[1] - polygon[0][1]) - (b[0] - polygon[0][0]) * (a[1] - polygon[0][1]);
    }
    return sum / 2;
  }
  function clip(subject, by) { // Sutherland and Hodgman, both counter-clockwise
    for (let k = 0; k < by.length && subject.length; k++) {
      const s = by[k], e = by[(k + 1) % by.length], kept = [];
      const side = subject.map(function (c) { return (e[0] - s[0]) * (c[1] - s[1]) - (e[1] - s[1]) * (c[0] - s[0]); });
      for (let n = 0; n < subject.length; n++) {
        const m = (n + 1) % subject.length, a = side[n], b = side[m];
        if (a >= 0) kept.push(subject[n]);
        if ((a < 0) !== (b < 0)) kept.push([0, 1].map(function (i) { return subject[n][i] + (subject[m][i] - subject[n][i]) * (a / (a - b)); }));
      }
      subject = kept;
    }
    return subject.length > 2 ? subject : [[0, 0], [0, 0], [0, 0]];
  }
  function moved(polygon, by) { return polygon.map(function (c) { return [c[0] + by[0], c[1] + by[1]]; }); }
  function half(polygon, k) {
    const along = polygon.map(function (c) { return c[k]; });
    return (Math.max.apply(null, along) - Math.min.apply(null, along)) / 2;
  }

  /* Where light of slope a in air, bent by the slab's glass, reaches array 2 from the centre of cell 1; lengths. */
  function slabLanding(facts, turn, thickness, a) {
    const n = facts.index, axis = toSheet(turn, [0, 0, 1]), long = Math.hypot(a[0], a[1], 1);
    const u = [a[0] / long, a[1] / long, 1 / long];
    const c = u[0] * axis[0] + u[1] * axis[1] + u[2] * axis[2];
    const push = Math.sqrt(n * n - 1 + c * c) - c; // Snell: n u' = u + push axis
    const g = u.map(function (v, k) { return v + push * axis[k]; });
    return [thickness * g[0] / g[2], thickness * g[1] / g[2]];
  }
  /* Displacement of the slab's own array 2; `drift` as of a sheet, of its own cells; lengths. */
  function slabShift(facts, turn, d, s, drift) {
    const thick = toSheet(turn, [d[0], d[1], facts.index * s]);
    if (facts.aim) return slabLanding(facts, turn, thick[2], [0, 0]).map(function (v, k) { return v - drift * facts.aim[k]; });
    if (facts.aperture === "aligned") return [0, 0];
    return facts.aperture === "centred" ? [thick[0], thick[1]] : slabLanding(facts, turn, thick[2], facts.aperture);
  }

  /* Middle of cell (0, 0), in pitches; `tall` is the height of a rectangular cell over its width. */
  function firstCentre(hexagonal, count, tall) {
    if (!hexagonal) return [-0.5 * (count[0] - 1), -0.5 * (count[1] - 1) * tall];
    return [-0.5 * (count[0] - 1 + Math.floor(count[1] / 2) / count[1]), -0.5 * (count[1] - 1) * Math.sqrt(3) / 2];
  }
  /* Steps to the nearest middle of a cell, and the rest; p in pitches, from the middle of a cell. */
  function relocated(hexagonal, tall, p) {
    const py = hexagonal ? Math.sqrt(3) / 2 : tall;
    let best = null;
    const j0 = Math.floor(p[1] / py + 0.5), i0 = Math.floor(p[0] - (hexagonal ? 0.5 * j0 : 0) + 0.5);
    for (let j = j0 - 1; j <= j0 + 1; j++) for (let i = i0 - 1; i <= i0 + 1; i++) {
      const rest = [p[0] - i - (hexagonal ? 0.5 * j : 0), p[1] - j * py], far = Math.hypot(rest[0], rest[1]);
      if (best === null || far < best.far) best = { far: far, steps: [i, j], rest: rest };
    }
    return best;
  }

  function sheet(facts, state) {
    const s = state.separation, pitch = [state.pitch, state.pitch * facts.pitch[1] / facts.pitch[0]];
    const hexagonal = facts.kind === "hexagonal";
    const count = [0, 1].map(function (k) {
      return Math.max(1, Math.round(facts.count[k] * (facts.pitch[0] / state.pitch)));
    });
    const turn = rotation(state.euler, facts.axes);
    const power1 = state.eta.map(function (e) { return (1 - e) / s; });
    const power2 = state.eta.map(function (e) { return -(1 - e) / (e * s); });
    const d = state.delta.map(function (v, k) { return v === 0 || power1[k] === 0 ? 0 : v / power1[k]; });
    const offset = toSheet(turn, [d[0], d[1], s]);
    // an aimed sheet: cells of array 2 where light of the viewer arrives, a lattice with a larger or smaller pitch
    const drift = facts.aim ? -offset[2] / facts.aim[2] : 0, grow = 1 + drift;
    const shift = facts.aim ? [-drift * facts.aim[0], -drift * facts.aim[1]] : facts.aperture === "centred" ? [offset[0], offset[1]]
      : facts.aperture === "aligned" ? [0, 0] : [offset[2] * facts.aperture[0], offset[2] * facts.aperture[1]];
    const first = firstCentre(hexagonal, count, pitch[1] / pitch[0]).map(function (v) { return v * pitch[0]; });
    const solidDrift = drift * facts.built, solidShift = facts.form === "slab" ? slabShift(facts, turn, d, s, solidDrift) : shift;
    const tile = tileOf(facts, pitch), opening = facts.baffle === null ? facts.seam : Math.max(facts.seam, facts.baffle);
    const lit = less(tile, pitch, opening, hexagonal);
    const pitch2 = pitch.map(function (v) { return grow * v; }), tile2 = tile.map(function (c) { return [grow * c[0], grow * c[1]]; });
    const axis = toSheet(turn, [0, 0, 1]);
    function inLensPlane(p) { return toLens(turn, [p[0], p[1], -(p[0] * axis[0] + p[1] * axis[1]) / axis[2]]).slice(0, 2); }
    const zone = lit.map(inLensPlane), zone2 = less(tile2, pitch2, opening, hexagonal).map(inLensPlane);
    let image = zone.map(function (c) { return [c[0] * state.eta[0], c[1] * state.eta[1]]; });
    if (area(image) < 0) image = image.slice().reverse();
    const at = toLens(turn, offset), rest = inLensPlane([shift[0] - offset[0], shift[1] - offset[1]]);
    return {
      facts: facts, state: state, s: s, pitch: pitch, count: count, hexagonal: hexagonal, turn: turn, power1: power1,
      power2: power2, offset: offset, shift: shift, drift: drift, solidShift: solidShift, solidDrift: solidDrift, first: first, tile: tile, zone: zone, zone2: zone2,
      image: image, centre: [at[0] + rest[0], at[1] + rest[1]], part: Math.abs(area(lit) / area(tile)),
      middle: [shift[0] / offset[2], shift[1] / offset[2]], inLensPlane: inLensPlane,
    };
  }

  const NEAREST = 10; // as in clacad/prescription/aimed_cells.py
  /* Why no such sheet can be made, of what closed forms know; "" where nothing is against it. */
  function unbuildable(made) {
    const f = made.facts, e = made.state.eta;
    if (e[0] === 1 && e[1] === 1) return "\u03b7 = 1 in x and y is a plain window, without lenses";
    const factor = (f.index - 1) * (f.form === "biconvex" ? 2 : 1);
    const reach = Math.max.apply(null, made.tile.map(function (c) { return Math.hypot(c[0], c[1]); }));
    for (let k = 0; k < 2; k++) for (const power of [made.power1[k], made.power2[k]]) {
      const lens = "lens " + (power === made.power1[k] ? 1 : 2);
      if (power !== 0 && Math.abs(factor / power) < reach) return lens + " would be curved more in " + "xy"[k] + " than its cell is wide";
      if (power < 0 && f.form === "biconvex" && (f.seam > 0 || f.border > 0 || f.outline)) {
        return lens + " is concave: it has no plate for a seam, a border or an outline";
      }
    }
    if (f.aim && Math.abs(f.aim[2]) < NEAREST * made.s) return "the sheet is aimed at a point nearer than " + NEAREST + " separations";
    return "";
  }

  /* Why a pair can have no field lens on the page; "" where it can. */
  function noFieldLens(made) {
    const e = made.state.eta, quarter = made.turn[0][0] * made.turn[0][1] === 0;
    if (e[0] >= 0 || e[1] >= 0) return "its common focus is virtual unless \u03b7 < 0 in x and y";
    if (made.facts.baffle !== null) return "not made with a baffle";
    if (made.facts.plate) return "not made in a plate with holes, corners, pins or a polygon";
    if (made.state.euler[1] !== 0) return "shown for lenses that are not tilted (\u03b8 = 0)";
    if (e[0] !== e[1] && (made.hexagonal || !quarter)) return "\u03b7x \u2260 \u03b7y: two crossed cylinders, which must run along the cells";
    return "";
  }
  function fieldLens(made) { return made.state.field && noFieldLens(made) === ""; }

  /* Share of the light on the cell with its middle at `cell` that meets its partner, for light along (x, y, 1). */
  function share(made, slope, cell) {
    const v = toLens(made.turn, [slope[0], slope[1], 1]), t = [v[0] / v[2], v[1] / v[2]];
    const apart = made.inLensPlane([made.drift * cell[0], made.drift * cell[1]]); // of the partner
    const centre = [made.centre[0] + apart[0], made.centre[1] + apart[1]];
    let to = [made.s * t[0], made.s * t[1]];
    if (fieldLens(made)) { // the field lens brings light to the partner that goes through the partner's own field cell
      const away = [0, 1].map(function (k) { return (t[k] - centre[k] / made.s) / made.power1[k] / fieldGrow(made)[k]; });
      const point = toSheet(made.turn, [away[0], away[1], 0]);
      if (!insideTile(made.tile, point)) return 0;
      to = centre;
    }
    return made.part * area(clip(moved(made.image, to), moved(made.zone2, centre))) / area(made.image);
  }
  /* Pitch of the cells of the field lens over array 1's, along lens x and y: they lie on the lines between partners. */
  function fieldGrow(made) { return made.power1.map(function (p) { return 1 + made.drift / (p * made.s); }); }
  /* Middle of the cell of array 1 that holds the sheet point p; lengths. */
  function cellAt(made, p) {
    const w = made.pitch[0], at = [0, 1].map(function (k) { return (p[k] - made.first[k]) / w; });
    const rest = relocated(made.hexagonal, made.pitch[1] / w, at).rest;
    return [p[0] - rest[0] * w, p[1] - rest[1] * w];
  }
  function insideTile(tile, p) {
    return tile.every(function (a, k) {
      const b = tile[(k + 1) % tile.length];
      return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) >= 0;
    });
  }
  function eyePlace(state) {
    const [ca, sa] = cosSin(state.azimuth), [ce, se] = cosSin(state.elevation);
    return [state.eye * sa * ce, state.eye * se, -state.eye * ca * ce];
  }
  const GRID = 9;
  /* Mean of the share over the sheet, of the light that reaches the eye: GRID by GRID points that lie on cells. */
  function shareFromEye(made) {
    const eye = eyePlace(made.state), row = made.hexagonal ? made.pitch[0] * Math.sqrt(3) / 2 : made.pitch[1];
    const wide = made.count[0] * made.pitch[0], tall = made.count[1] * row, outline = made.facts.outline;
    let sum = 0, points = 0;
    for (let i = 0; i < GRID; i++) for (let j = 0; j < GRID; j++) {
      const p = [((i + 0.5) / GRID - 0.5) * wide, ((j + 0.5) / GRID - 0.5) * tall];
      if (outline && (outline[0] === "circle" ? Math.hypot(p[0], p[1]) > outline[1] / 2
        : Math.abs(p[0]) > outline[1] / 2 || Math.abs(p[1]) > outline[2] / 2)) continue;
      sum += share(made, [(p[0] - eye[0]) / -eye[2], (p[1] - eye[1]) / -eye[2]], cellAt(made, p)); points++;
    }
    return points ? sum / points : 0;
  }
  function halfField(made) {
    return [0, 1].map(function (k) {
      if (!fieldLens(made)) return (half(made.zone2, k) + half(made.image, k)) / made.s;
      return half(made.tile.map(function (c) { return toLens(made.turn, [c[0], c[1], 0]); }), k) * made.power1[k] * fieldGrow(made)[k];
    });
  }
  function ghostOnset(made) {
    const field = fieldLens(made) ? halfField(made) : null;
    return [0, 1].map(function (k) {
      const free = Math.max(0, half(made.zone2, k) - half(made.image, k)) / made.s;
      return field === null ? free : Math.abs(made.state.eta[k]) > 1 ? 0 : field[k];
    });
  }
  function sharpestPitch(eta, distance, wavelength) {
    const defocus = Math.abs(eta * (1 - eta));
    return defocus > 0 ? Math.sqrt(2 * wavelength * distance / defocus) * Math.max(1, Math.abs(eta)) : Infinity;
  }
  function sharpestBlur(eta, distance, viewer, wavelength) {
    const beam = sharpestPitch(eta, distance, wavelength) * Math.min(1, 1 / Math.abs(eta)), image = distance / eta;
    if (!isFinite(beam)) return 0;
    return viewer + image ? 0.72 * wavelength * Math.abs(image) / (beam * Math.abs(viewer + image)) : Infinity;
  }
  function verdict(made) {
    const f = made.facts, st = made.state, z = st.object * f.unitM, viewer = st.eye * f.unitM;
    const sharpest = st.eta.map(function (e) { return sharpestPitch(e, z, f.wavelength) / f.unitM; });
    const blur = st.eta.map(function (e) { return sharpestBlur(e, z, viewer, f.wavelength); });
    return {
      share: share(made, made.middle, [0, 0]), share_from_eye: shareFromEye(made), half_field: halfField(made),
      ghost_onset: ghostOnset(made), sharpest_pitch: sharpest, advised_pitch: sharpest[blur[0] > blur[1] ? 0 : 1],
    };
  }
  return {
    sheet: sheet, share: share, verdict: verdict, noFieldLens: noFieldLens, unbuildable: unbuildable, fieldLens: fieldLens, eyePlace: eyePlace,
    toLens: toLens, toSheet: toSheet, area: area, relocated: relocated, fieldGrow: fieldGrow,
  };
})();
