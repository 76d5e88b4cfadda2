// Sorts the table by a column: upwards first, downwards when clicked again; what is not known comes last.
const heads = [...document.querySelectorAll("thead th")];
const body = document.querySelector("tbody");
const key = (row, column) => row.children[column].dataset.sort;
heads.forEach((head, column) => head.querySelector("button")?.addEventListener("click", () => {
  const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
  heads.forEach((other) => other.removeAttribute("aria-sort"));
  head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
  const numbers = column > 1;
  const compare = (a, b) => {
    const [x, y] = [key(a, column), key(b, column)];
    if (x === "" || y === "") return (x === "") - (y === "");
    return sign * (numbers ? x - y : x.localeCompare(y));
  };
  body.append(...[...body.rows].sort(compare));
}));
