/* Values of drawings under the pointer, and series that a click on the legend hides. */
const short = v => v === 0 ? "0" : Math.abs(v) >= 1e5 || Math.abs(v) < 1e-3 ? v.toExponential(2).replace("e+", "e") : String(+v.toPrecision(4));
const bent = (v, s) => s.scale === "log" ? Math.log10(v) : s.scale !== "symlog" ? v
  : Math.abs(v) <= s.linear ? v / 0.9 : Math.sign(v) * s.linear * (1 / 0.9 + Math.log10(Math.abs(v) / s.linear));
const straight = (u, s) => s.scale === "log" ? 10 ** u : s.scale !== "symlog" ? u
  : Math.abs(u) <= s.linear / 0.9 ? u * 0.9 : Math.sign(u) * s.linear * 10 ** (Math.abs(u) / s.linear - 1 / 0.9);
const read = (share, s) => {
  const [a, b] = s.ends.map(end => bent(end, s)), v = straight(a + share * (b - a), s);
  if (!s.names) return `${s.label ? s.label + ": " : ""}${short(v)}`;
  const nearest = Object.keys(s.names).reduce((p, q) => Math.abs(p - v) < Math.abs(q - v) ? p : q);
  return s.names[nearest];
};
const vertices = svg => {  /* the places that were drawn, each with its series */
  const found = [], series = {};
  for (const text of svg.querySelectorAll('[id*="toggle-"]')) series[text.id.match(/toggle-(\d+)\./)[1]] = text.textContent.trim();
  for (const mark of svg.querySelectorAll('g[id*="line2d_"] > path, g[id*="series-"] path, g[id*="series-"] use, g[id*="line2d_"] use')) {
    if (mark.closest('defs, [id*="matplotlib.axis"], [id*="legend_"]')) continue;
    const group = mark.closest('[id*="series-"]'), name = group ? series[group.id.match(/series-(\d+)\./)[1]] : "";
    if (mark.tagName === "use") found.push([+mark.getAttribute("x"), +mark.getAttribute("y"), name, group]);
    else for (const m of (mark.getAttribute("d") || "").matchAll(/(-?[\d.]+(?:e-?\d+)?) (-?[\d.]+(?:e-?\d+)?)(?=\s|$)/g)) found.push([+m[1], +m[2], name, group]);
  }
  return found;
};
for (const svg of document.querySelectorAll("svg[data-axes]")) {
  const axes = JSON.parse(svg.dataset.axes), figure = svg.closest("figure");
  if (!axes.length || !figure) continue;
  let places = null, label = null;
  const hide = () => { if (label) label.hidden = true; };
  svg.addEventListener("pointerleave", hide);
  svg.addEventListener("pointermove", event => {
    const matrix = svg.getScreenCTM(), p = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
    const axis = axes.find(({box: [l, t, r, b]}) => p.x >= l && p.x <= r && p.y >= t && p.y <= b);
    if (!axis) return hide();
    places ??= vertices(svg);
    const [l, t, r, b] = axis.box, reach = 12 / matrix.a;
    let near = null, least = reach * reach;
    for (const place of places) {
      const d = (place[0] - p.x) ** 2 + (place[1] - p.y) ** 2;
      if (d < least && !place[3]?.hasAttribute("hidden")) [near, least] = [place, d];
    }
    const [x, y] = near ?? [p.x, p.y];
    if (!label) { label = document.createElement("output"); label.className = "reading"; figure.append(label); }
    label.textContent = [near?.[2], read((x - l) / (r - l), axis.x), read((b - y) / (b - t), axis.y)].filter(Boolean).join("\n");
    label.hidden = false;
    const frame = figure.getBoundingClientRect(), left = event.clientX - frame.left;
    label.style.top = `${event.clientY - frame.top + 14}px`;
    label.style.left = `${Math.max(0, Math.min(left + 14, frame.width - label.offsetWidth))}px`;
  });
  for (const text of svg.querySelectorAll('[id*="toggle-"]')) {
    const number = text.id.match(/toggle-(\d+)\./)[1];
    const flip = () => {
      const off = text.getAttribute("aria-pressed") === "true";
      text.setAttribute("aria-pressed", String(!off));
      for (const part of svg.querySelectorAll(`[id*="series-${number}."]`)) part.toggleAttribute("hidden", off);
    };
    for (const [key, word] of [["role", "button"], ["tabindex", "0"], ["aria-pressed", "true"]]) text.setAttribute(key, word);
    text.addEventListener("click", flip);
    text.addEventListener("keydown", event => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); flip(); } });
  }
}
