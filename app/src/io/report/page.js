// Sorts the tables of the page by a column, and shows the rows that hold a text.
for (const box of document.querySelectorAll(".sortable")) {
  const body = box.querySelector("tbody");
  const rows = [...body.rows];
  const value = (row, at) => {
    const text = row.cells[at].textContent;
    const number = parseFloat(text);
    // Equal pictures have no error at all.
    return text === "equal" ? Infinity : Number.isNaN(number) ? text : number;
  };
  const compare = (a, b) =>
    typeof a === typeof b ? (a < b ? -1 : a > b ? 1 : 0) : typeof a === "number" ? -1 : 1;
  box.querySelectorAll("th button").forEach((button, at) => {
    let rising = false;
    button.addEventListener("click", () => {
      rising = !rising;
      const sorted = [...rows].sort((a, b) => compare(value(a, at), value(b, at)) * (rising ? 1 : -1));
      body.append(...sorted);
    });
  });
  box.querySelector("input").addEventListener("input", (event) => {
    const wanted = event.target.value.toLowerCase();
    for (const row of rows) row.hidden = !row.textContent.toLowerCase().includes(wanted);
  });
}
