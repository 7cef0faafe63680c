// The leaderboard: rows that can be sorted and filtered.

const COLUMNS = [
  { key: "policy", title: "policy" },
  { key: "id", title: "environment", optional: true },
  { key: "motion", title: "motion", optional: true },
  { key: "condition", title: "what is known", optional: true },
  { key: "payload", title: "payload [kg]", number: true },
  { key: "share", title: "share of the best found", number: true },
  { key: "limit", title: "what gives way beyond", optional: true },
];

function makeBoard(rows, open) {
  const state = { sort: "share", descending: true, current: null };
  const head = document.querySelector("#board thead tr"), body = document.querySelector("#board tbody");
  const filters = Object.fromEntries(["id", "motion", "condition"].map((key) => [key, document.getElementById(`filter-${key}`)]));
  const search = document.getElementById("filter-policy");

  for (const column of COLUMNS) {
    const cell = element("th", { scope: "col", class: [column.number && column.key !== "share" ? "number" : "", column.optional ? "optional" : ""].join(" ") });
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

  function wanted() {
    const part = search.value.trim().toLowerCase();
    return rows.filter((row) => Object.entries(filters).every(([key, select]) => !select.value || row[key] === select.value)
      && row.policy.toLowerCase().includes(part));
  }

  function compare(one, other) {
    // Where there is no best found, and so no share, payloads tell the rows apart.
    const key = state.sort === "share" && one.share === null && other.share === null ? "payload" : state.sort;
    const a = one[key], b = other[key];
    if (a === null || b === null) return (a === null) - (b === null);  // what has no number comes last either way
    const order = typeof a === "number" ? a - b : String(a).localeCompare(String(b));
    return state.descending ? -order : order;
  }

  function draw() {
    const shown = wanted().sort(compare);
    for (const column of COLUMNS) {
      const sorted = column.key === state.sort;
      column.head.setAttribute("aria-sort", sorted ? (state.descending ? "descending" : "ascending") : "none");
      column.head.firstChild.textContent = column.title + (sorted ? (state.descending ? " ▼" : " ▲") : "");
    }
    body.replaceChildren(...shown.map(drawnRow));
    document.getElementById("count").textContent = `${shown.length} of ${rows.length} rows`;
  }

  function drawnRow(row) {
    const line = element("tr", row.key === state.current ? { "aria-current": "true" } : {});
    const button = element("button", { type: "button", text: row.policy, "aria-label": `${row.policy}: show its episode` });
    button.addEventListener("click", () => open(row, true));
    const policy = element("td");
    policy.append(button);
    line.append(policy, element("td", { class: "optional", text: row.id.replace("CableBot-", "").replace("-v0", "") }),
      element("td", { class: "optional", text: row.motion }), element("td", { class: "optional", text: row.condition }),
      element("td", { class: "number", text: row.weight }), shareCell(row), element("td", { class: "optional", text: row.limit }));
    return line;
  }

  function shareCell(row) {
    const cell = element("td");
    if (row.share === null) {
      cell.textContent = row.note;
      return cell;
    }
    const box = element("div", { class: "share" }), track = element("div", { class: "track", "aria-hidden": "true" });
    track.append(element("div", { class: "fill", style: `width:${percent(row.share)}` }));
    if (row.interval) {
      const [low, high] = row.interval;
      track.append(element("div", { class: "whisker", style: `left:${percent(low)};width:${percent(high - low)}` }));
    }
    const spread = row.interval ? `, ${percent(row.interval[0])} to ${percent(row.interval[1])}` : "";
    box.append(element("span", { class: "text", text: percent(row.share) + (row.raised ? "*" : ""), title: `${percent(row.share)}${spread}` }), track);
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
