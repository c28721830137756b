for (const button of document.querySelectorAll("button.copy")) {
  button.hidden = false;
  button.addEventListener("click", async () => {
    const from = button.parentElement.querySelector("pre");
    try { await navigator.clipboard.writeText(from.textContent); }
    catch { getSelection().selectAllChildren(from); document.execCommand("copy"); }
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
}

const digits = {"⁻": "-", "⁰": 0, "¹": 1, "²": 2, "³": 3, "⁴": 4, "⁵": 5, "⁶": 6, "⁷": 7, "⁸": 8, "⁹": 9};
const value = cell => {
  const text = cell.textContent.replace(/\u202f/g, "").replace(/\u2212/g, "-")
    .replace(/(?: × )?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)/, (all, power) => (all[0] === "1" ? "1e" : "e") + [...power].map(c => digits[c]).join(""));
  const found = text.match(/^[^\d-]*(-?\d[\d.]*(?:e-?\d+)?)/);
  return found ? Number(found[1]) : text;
};
for (const table of document.querySelectorAll("table")) {
  if (table.rows.length < 4) continue;
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const rows = [...table.tBodies].flatMap(body => [...body.rows]), sizes = [...table.tBodies].map(body => body.rows.length);
      rows.sort((a, b) => {
        const [x, y] = [value(a.cells[column]), value(b.cells[column])];
        return (up ? 1 : -1) * (typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y)));
      });
      [...table.tBodies].forEach((body, k) => body.append(...rows.splice(0, sizes[k])));
    });
  });
}
