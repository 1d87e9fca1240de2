// Sorts the tables of the page by a column, filters their rows by a text, and shows the pictures of a row.
for (const box of document.querySelectorAll(".sortable")) {
  const body = box.querySelector("tbody");
  const rows = [...body.rows];
  const shown = new Map();
  const value = (row, at) => {
    const text = row.cells[at].textContent;
    const number = parseFloat(text);
    // Equal pictures have an infinite PSNR.
    return text === "equal" ? Infinity : Number.isNaN(number) ? text : number;
  };
  const compare = (a, b) =>
    typeof a === typeof b ? (a < b ? -1 : a > b ? 1 : 0) : typeof a === "number" ? -1 : 1;
  const below = (row) => (shown.has(row) ? [row, shown.get(row)] : [row]);
  box.querySelectorAll("th button").forEach((button, at) => {
    let rising = false;
    button.addEventListener("click", () => {
      rising = !rising;
      const sorted = [...rows].sort((a, b) => compare(value(a, at), value(b, at)) * (rising ? 1 : -1));
      body.append(...sorted.flatMap(below));
    });
  });
  box.querySelector("input").addEventListener("input", (event) => {
    const wanted = event.target.value.toLowerCase();
    for (const row of rows) {
      const hidden = ![...row.cells].some((cell) => cell.textContent.toLowerCase().includes(wanted));
      for (const each of below(row)) each.hidden = hidden;
    }
  });
  for (const row of rows) {
    const pictures = row.querySelector("template");
    row.querySelector("a")?.addEventListener("click", (event) => {
      event.preventDefault();
      if (shown.has(row)) {
        shown.get(row).remove();
        shown.delete(row);
        return;
      }
      const below = document.createElement("tr");
      below.append(document.createElement("td"));
      below.cells[0].colSpan = row.cells.length;
      below.cells[0].append(pictures.content.cloneNode(true));
      row.after(below);
      shown.set(row, below);
    });
  }
}
