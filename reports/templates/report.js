"use strict";
// Tables: a click on a column's head sorts by it, numbers by size (data-sort, or what the cell says), the rest by name.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    const key = (row) => row.cells[column].dataset.sort ?? row.cells[column].textContent.trim();
    const empty = (text) => text === "" || text === "--";
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const rows = [...body.rows].sort((first, second) => {
        const [a, b] = [key(first), key(second)];
        if (empty(a) || empty(b)) return empty(a) - empty(b); // what has no value stays below
        const order = isNaN(a) || isNaN(b) ? a.localeCompare(b, "en", { numeric: true }) : a - b;
        return down ? -order : order;
      });
      body.append(...rows);
    });
  });
}

// The list of all numbers, by verdict and by words.
const all = document.querySelector("#all-numbers table");
const chosen = document.querySelector("#verdict"), words = document.querySelector("#words");
const filter = () => {
  for (const row of all.tBodies[0].rows) {
    const text = row.textContent.toLowerCase();
    const fits = chosen.value === "" || (chosen.value === "measured" ? row.dataset.measured : row.dataset.verdict === chosen.value);
    row.hidden = !(fits && words.value.toLowerCase().split(" ").every((word) => text.includes(word)));
  }
};
chosen.addEventListener("change", filter);
words.addEventListener("input", filter);
filter();

// Figures: a click shows one large, the next one pixel by pixel.
const dialog = document.querySelector("dialog"), large = dialog.querySelector("img");
for (const image of document.querySelectorAll(".plot img")) {
  image.tabIndex = 0;
  const open = () => {
    large.src = image.src;
    large.alt = image.alt;
    dialog.classList.toggle("close-up", image.naturalWidth > 2 * innerWidth); // on a phone, at once
    dialog.classList.toggle("photo", image.matches(".photo img")); // keeps its colours in the dark
    dialog.showModal();
  };
  image.addEventListener("click", open);
  image.addEventListener("keydown", (event) => event.key === "Enter" && open());
}
large.addEventListener("click", () => dialog.classList.toggle("close-up"));
dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());

// Films, side by side.
const films = document.querySelectorAll("video");
document.querySelector("#play-all")?.addEventListener("click", (event) => {
  const play = event.target.dataset.playing !== "yes";
  event.target.dataset.playing = play ? "yes" : "no";
  event.target.textContent = play ? "Pause all" : "Play all";
  for (const film of films) {
    film.currentTime = play ? 0 : film.currentTime;
    play ? film.play() : film.pause();
  }
});

// Contents: open where there is room for a column of them.
document.querySelector("nav details").open = matchMedia("(min-width: 70rem)").matches;
