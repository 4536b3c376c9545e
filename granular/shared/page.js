for (const drawing of document.querySelectorAll("figure svg"))
  drawing.addEventListener("click", () => drawing.parentNode.classList.toggle("large"));
document.addEventListener("keydown", event => { if (event.key === "Escape")
  document.querySelectorAll("figure.large").forEach(shown => shown.classList.remove("large")); });
const number = cell => parseFloat(cell.replace(/^[^\d.+-]+/, "").replace(/(\d)[, ](?=\d{3}\b)/g, "$1"));
function compare(a, b, up) {  // what is no number comes last
  const [x, y] = [number(a), number(b)];
  if (isNaN(x) !== isNaN(y)) return isNaN(x) ? 1 : -1;
  return (up ? 1 : -1) * (isNaN(x) ? a.localeCompare(b) : x - y);
}
for (const table of document.querySelectorAll("table")) {
  const [body, heads] = [table.tBodies[0], table.querySelectorAll("th")];
  if (body.rows.length > 2) heads.forEach((head, column) => {
    head.setAttribute("aria-sort", "none");
    head.tabIndex = 0;
    head.addEventListener("keydown", event => { if (event.key === "Enter") head.click(); });
    head.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach(other => other.setAttribute("aria-sort", "none"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const cell = row => row.cells[column].textContent;
      const rows = [...body.rows].sort((a, b) => compare(cell(a), cell(b), up));
      body.append(...rows);
    });
  });
}
