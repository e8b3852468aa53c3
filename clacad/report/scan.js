"use strict";
(function () {
  const scan = JSON.parse(document.getElementById("scan").dataset.scan);
  const slider = document.getElementById("position"), drawing = document.getElementById("section");
  const all = scan.sections.flatMap((one) => one.rays.flat());
  const reach = 2.2 * Math.max(...scan.sections[0].plates[0][0].map((point) => Math.abs(point[0]))) / 5;
  const low = Math.min(...all.map((point) => point[1])), high = Math.max(...all.map((point) => point[1]));
  const wide = 900, tall = 300;
  const at = (point) => [wide * (point[1] - low) / (high - low), tall * (0.5 - 0.5 * point[0] / reach)];
  const path = (points) => "M" + points.filter((p) => p[1] !== null).map((p) => at(p).map((v) => v.toFixed(1)).join(" ")).join("L");
  const add = (shape, style) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", "path");
    made.setAttribute("d", shape);
    made.setAttribute("class", style);
    drawing.appendChild(made);
  };
  const number = (value, digits) => value === null ? "not computed" : value.toPrecision(digits);
  const thousandths = (value) => value === null ? "no light" : (1e3 * value).toFixed(3);
  function show() {
    const k = Number(slider.value), position = scan.positions[k], section = scan.sections[k];
    drawing.replaceChildren();
    for (const faces of section.plates) {
      const outline = faces[0].concat([...faces[faces.length - 1]].reverse());
      add(path(outline) + "Z", "plate");
      for (const face of faces) add(path(face), "face");
    }
    section.rays.forEach((ray, n) => add(path(ray), section.wanted[n] ? "ray" : "ray stray"));
    const put = (name, text) => { document.getElementById(name).textContent = text; };
    put("travel", number(position.travel, 4) + " " + scan.unit);
    put("slope", thousandths(position.slope_x) + ", " + thousandths(position.slope_y));
    put("closed", thousandths(position.closed_form_x) + ", " + thousandths(position.closed_form_y));
    put("spread", position.spread === null ? "no light" : number(1e3 * position.spread, 4) + " mrad");
    put("share", number(100 * position.share, 4) + " %");
    put("beam", number(position.exit_beam_over_pitch, 4));
    put("power", number(position.power, 4) + " 1/m");
    put("order", position.diffraction_order_x + ", " + position.diffraction_order_y);
    put("efficiency", number(position.efficiency, 4) + "; on order " + number(position.efficiency_on_order, 4));
    put("orders", position.orders.map((one) => "(" + one.order.join(", ") + "): " + (100 * one.share).toFixed(2)
      + " % at " + one.slope.map((v) => (1e3 * v).toFixed(1)).join(", ")).join("; "));
  }
  slider.addEventListener("input", show);
  show();
})();
