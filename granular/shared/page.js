for (const drawing of document.querySelectorAll("figure svg"))
  drawing.addEventListener("click", () => drawing.parentNode.classList.toggle("large"));
document.addEventListener("keydown", event => { if (event.key === "Escape")
  document.querySelectorAll("figure.large").forEach(shown => shown.classList.remove("large")); });
const number = cell => parseFloat(cell.replace(/^[<>≈ ]+/, ""));
function compare(a, b) {
  const [x, y] = [number(a), number(b)];
  return isNaN(x) || isNaN(y) ? isNaN(x) - isNaN(y) || a.localeCompare(b) : x - y;
}
for (const table of document.querySelectorAll("table")) {
  const [body, heads] = [table.tBodies[0], table.querySelectorAll("th")];
  if (body.rows.length > 2) heads.forEach((head, column) => {
    head.setAttribute("aria-sort", "none");
    head.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach(other => other.setAttribute("aria-sort", "none"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const cell = row => row.cells[column].textContent;
      const rows = [...body.rows].sort((a, b) => (up ? 1 : -1) * compare(cell(a), cell(b)));
      body.append(...rows);
    });
  });
}
