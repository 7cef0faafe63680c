// The leaderboard as a sortable and filterable table.

const COLUMNS = [
  { key: "policy", title: "policy" },
  { key: "id", title: "environment", optional: true },
  { key: "motion", title: "motion", optional: true },
  { key: "condition", title: "conditions", optional: true },
  { key: "payload", title: "payload [kg]", number: true },
  { key: "fraction", title: "fraction of the optimum", number: true },
  { key: "violation", title: "limiting violation", optional: true },
];

function makeLeaderboard(rows, openRow) {
  const state = { sort: "fraction", descending: true, current: null };
  const head = document.querySelector("#leaderboard-table thead tr"), body = document.querySelector("#leaderboard-table tbody");
  const filters = Object.fromEntries(["id", "motion", "condition"].map((key) => [key, document.getElementById(`filter-${key}`)]));
  const search = document.getElementById("filter-policy");

  for (const column of COLUMNS) {
    const cell = element("th", { scope: "col", class: [column.number && column.key !== "fraction" ? "number" : "", column.optional ? "optional" : ""].join(" ") });
    const button = element("button", { type: "button", text: column.title });
    button.addEventListener("click", () => {
      state.descending = state.sort === column.key ? !state.descending : Boolean(column.number);
      state.sort = column.key;
      draw();
    });
    cell.append(button);
    head.append(cell);
    column.head = cell;
  }

  for (const [key, select] of Object.entries(filters)) {
    select.append(element("option", { value: "", text: "all" }));
    for (const value of new Set(rows.map((row) => row[key]))) select.append(element("option", { value, text: value }));
    select.addEventListener("change", draw);
  }
  search.addEventListener("input", draw);
  document.getElementById("filters").addEventListener("submit", (event) => event.preventDefault());

  function filteredRows() {
    const text = search.value.trim().toLowerCase();
    return rows.filter((row) => Object.entries(filters).every(([key, select]) => !select.value || row[key] === select.value)
      && row.policy.toLowerCase().includes(text));
  }

  function compare(one, other) {
    // Rows without an optimum have no fraction and are sorted by payload.
    const key = state.sort === "fraction" && one.fraction === null && other.fraction === null ? "payload" : state.sort;
    const a = one[key], b = other[key];
    if (a === null || b === null) return (a === null) - (b === null);  // missing numbers come last in both directions
    const order = typeof a === "number" ? a - b : String(a).localeCompare(String(b));
    return state.descending ? -order : order;
  }

  function draw() {
    const shown = filteredRows().sort(compare);
    for (const column of COLUMNS) {
      const sorted = column.key === state.sort;
      column.head.setAttribute("aria-sort", sorted ? (state.descending ? "descending" : "ascending") : "none");
      column.head.firstChild.textContent = column.title + (sorted ? (state.descending ? " ▼" : " ▲") : "");
    }
    body.replaceChildren(...shown.map(drawRow));
    document.getElementById("count").textContent = `${shown.length} of ${rows.length} rows`;
  }

  function drawRow(row) {
    const line = element("tr", row.key === state.current ? { "aria-current": "true" } : {});
    const button = element("button", { type: "button", text: row.policy, "aria-label": `${row.policy}: show the episode` });
    button.addEventListener("click", () => openRow(row, true));
    const policy = element("td");
    policy.append(button);
    line.append(policy, element("td", { class: "optional", text: row.id.replace("CableBot-", "").replace("-v0", "") }),
      element("td", { class: "optional", text: row.motion }), element("td", { class: "optional", text: row.condition }),
      element("td", { class: "number", text: row.payload_text }), fractionCell(row), element("td", { class: "optional", text: row.violation }));
    return line;
  }

  function fractionCell(row) {
    const cell = element("td");
    if (row.fraction === null) return cell;
    const box = element("div", { class: "fraction" }), track = element("div", { class: "track", "aria-hidden": "true" });
    track.append(element("div", { class: "fill", style: `width:${percent(Math.min(1, row.fraction))}` }));
    if (row.interval) {
      const [low, high] = row.interval;
      track.append(element("div", { class: "whisker", style: `left:${percent(low)};width:${percent(high - low)}` }));
    }
    const interval = row.interval ? `, ${percent(row.interval[0])} to ${percent(row.interval[1])}` : "";
    box.append(element("span", { class: "text", text: percent(row.fraction), title: `${percent(row.fraction)}${interval}` }), track);
    cell.append(box);
    return cell;
  }

  return {
    draw,
    filters,
    mark(row) {
      state.current = row.key;
      draw();
    },
  };
}
