// Filters of the ledger: one list of papers and one of verdicts; a row is hidden if it is of another one.
document.addEventListener("DOMContentLoaded", () => {
  const rows = [...document.querySelectorAll("tr[data-verdict]")];
  if (!rows.length) return;
  const lists = ["paper", "verdict"].map((key) => {
    const list = document.createElement("select");
    list.setAttribute("aria-label", key);
    list.append(new Option(`${key}: all`, ""));
    for (const value of new Set(rows.map((row) => row.dataset[key]))) {
      list.append(new Option(`${key}: ${value}`, value));
    }
    list.addEventListener("change", show);
    return list;
  });
  function show() {
    const [paper, verdict] = lists.map((list) => list.value);
    for (const row of rows) {
      const isShown = [row.dataset.paper, ""].includes(paper) && [row.dataset.verdict, ""].includes(verdict);
      row.hidden = !isShown;
    }
  }
  const place = document.createElement("p");
  place.append(...lists);
  rows[0].closest("table").before(place);
});
