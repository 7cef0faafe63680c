// Puts the parts together: what is chosen in the leaderboard is shown as an episode.

const data = JSON.parse(document.getElementById("data").textContent);
const find = (id) => document.getElementById(id);

// ---------------------------------------------------------------------------------------------------------- colours

const dark = matchMedia("(prefers-color-scheme: dark)");
const THEMES = ["system", "light", "dark"];
let theme = "system";
try { theme = localStorage.getItem("cablebot-theme") ?? "system"; } catch { /* a page from a file may not remember */ }

function paintTheme() {
  document.documentElement.dataset.theme = theme === "system" ? (dark.matches ? "dark" : "light") : theme;
  find("theme").setAttribute("aria-label", `Colours: ${theme === "system" ? "as the system has them" : theme}`);
  scene?.draw();
}

find("theme").addEventListener("click", () => {
  theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
  try { localStorage.setItem("cablebot-theme", theme); } catch { /* see above */ }
  paintTheme();
});
dark.addEventListener("change", paintTheme);

// ---------------------------------------------------------------------------------------------------------- episode

let scene = null, shown = null, clocks = [], playing = null, asked = 0;
paintTheme();

async function inflated(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new DataView(await new Response(stream).arrayBuffer());
}

async function unpacked(replay) {
  const view = await inflated(replay.data), channels = {};
  let column = 0;
  for (const [name, components] of Object.entries(replay.channels)) {
    channels[name] = Array.from({ length: replay.frames }, () => new Array(components));
    for (let component = 0; component < components; component++, column++) {
      const low = replay.low[column], span = replay.high[column] - low;
      for (let frame = 0, level = 0; frame < replay.frames; frame++) {
        level += view.getInt16(2 * (column * replay.frames + frame), true);
        channels[name][frame][component] = low + level / data.levels * span;
      }
    }
  }
  channels.times = Array.from({ length: replay.frames }, (_, frame) => Math.min(frame / data.rate, replay.end));
  channels.radius = replay.radius;
  return channels;
}

function open(row, wanted) {
  stop();
  shown = row;
  board.mark(row);
  find("episode-title").textContent = `${row.policy} on ${row.id}, ${row.motion}, ${row.condition}`;
  const motions = find("motion");
  motions.replaceChildren(...row.cells.map((place) => element("option", { value: String(place), text: data.cells[place].title })));
  find("which-motion").hidden = row.cells.length < 2;
  history.replaceState(null, "", `#${encodeURIComponent(row.key)}`);
  openCell();
  if (wanted) find("episode").scrollIntoView();
}

function openCell() {
  const cell = data.cells[Number(find("motion").value)];
  const recipe = find("recipe"), facts = element("dl");
  for (const [term, text] of cell.facts) facts.append(element("dt", { text: term }), element("dd", { text }));
  recipe.replaceChildren(element("pre", { text: cell.code }), facts);
  find("replay").hidden = !cell.replays;
  if (!cell.replays) {
    find("verdict").className = "";
    find("verdict").textContent = cell.why;
    return;
  }
  find("payloads").replaceChildren(...cell.replays.map((replay, place) => {
    const label = element("label"), choice = element("input", { type: "radio", name: "payload", value: String(place) });
    choice.checked = place === 0;
    choice.addEventListener("change", () => showReplay(cell, replay));
    label.append(choice, `${replay.payload.toFixed(2)} kg, ${place ? "more than it carries" : cell.carries}`);
    return label;
  }));
  showReplay(cell, cell.replays[0]);
}

async function showReplay(cell, replay) {
  stop();
  const number = ++asked, frames = await unpacked(replay);
  if (number !== asked) return;  // another one was chosen meanwhile
  const robot = data.robots[cell.robot], motion = data.motions[cell.motion];
  const verdict = find("verdict");
  verdict.className = replay.carried ? "good" : "bad";
  verdict.textContent = replay.carried ? `${replay.payload.toFixed(2)} kg: carried` : `${replay.payload.toFixed(2)} kg: ${replay.limit}`;
  scene.show(robot, frames, motion);
  drawCharts(frames, motion, robot);
  find("tension-scale").textContent = `0 to ${robot.fullTension.toFixed(0)} N`;
  const slider = find("time");
  slider.max = String(frames.times.length - 1);
  slider.value = "0";
  find("replay").frames = frames;
  moveTo(0);
}

const AT_LIMIT = 0.999;  // of a drive command: laws that clip theirs never go beyond 1, and numbers here have 16 bits

function drawCharts(frames, motion, robot) {
  const column = (name, index, scale = 1) => frames[name].map((values) => scale * values[index]);
  const motors = robot.base.map((_, motor) => {
    const values = column("demand", motor), there = values.filter((value) => Math.abs(value) >= AT_LIMIT).length / values.length;
    const most = values.reduce((found, value) => (Math.abs(value) > Math.abs(found) ? value : found), 0);
    return { name: `motor ${motor + 1}`, values, note: `${most.toFixed(2)}${there ? `, at its limit ${percent(there)} of the time` : ""}` };
  });
  const cables = robot.base.map((_, cable) => ({ name: `cable ${cable + 1}`, values: column("tension", cable) }));
  const peak = Math.min(3, Math.max(1.2, ...motors.flatMap((one) => one.values.map(Math.abs))));
  const error = (name, scale, bound) => {
    const values = column(name, 0, scale);
    return { x: frames.times, series: [{ name: "error", values, plain: true, note: `${Math.max(...values).toFixed(2)} at most, bound ${bound}` }],
      range: [0, Math.max(1.25 * bound, Math.min(3 * bound, ...[Math.max(...values)]))], bounds: [bound], tube: [0, bound] };
  };
  const plots = {
    "chart-demand": { x: frames.times, series: motors, range: [-peak, peak], bounds: [-1, 1], label: "Drive command of each motor over time" },
    "chart-position": { ...error("position_error", 1e3, 1e3 * motion.bound), label: "Position error over time" },
    "chart-tension": { x: frames.times, series: cables, bounds: [0], label: "Tension of each cable over time",
      range: [Math.min(0, ...cables.flatMap((one) => one.values)), Math.max(1, ...cables.flatMap((one) => one.values))] },
  };
  find("figure-rotation").hidden = !frames.rotation_error;
  if (frames.rotation_error) plots["chart-rotation"] = { ...error("rotation_error", 1e3, 1e3 * motion.rotation), label: "Rotation error over time" };
  clocks = Object.entries(plots).map(([id, options]) => {
    const chart = lineChart(options);
    find(id).replaceChildren(chart.node);
    return chart;
  });
}

function moveTo(frame) {
  const frames = find("replay").frames, time = frames.times[frame];
  find("time").value = String(frame);
  find("time").setAttribute("aria-valuetext", `${time.toFixed(2)} s`);
  find("clock").textContent = `${time.toFixed(2)} s`;
  scene.at(frame);
  for (const chart of clocks) chart.at(time);
}

function stop() {
  if (playing !== null) cancelAnimationFrame(playing);
  playing = null;
  find("play").textContent = "Play";
  find("play").setAttribute("aria-pressed", "false");
}

function play() {
  const frames = find("replay").frames, last = frames.times.length - 1;
  let time = Number(find("time").value) >= last ? 0 : frames.times[Number(find("time").value)], before = null;
  find("play").textContent = "Stop";
  find("play").setAttribute("aria-pressed", "true");
  const step = (now) => {
    if (before !== null) time += (now - before) / 1000 * Number(find("speed").value);
    before = now;
    const frame = Math.min(last, Math.floor(time * data.rate));
    moveTo(frame);
    if (frame < last) playing = requestAnimationFrame(step);
    else stop();
  };
  playing = requestAnimationFrame(step);
}

find("play").addEventListener("click", () => (playing === null ? play() : stop()));
find("time").addEventListener("input", () => { stop(); moveTo(Number(find("time").value)); });
find("motion").addEventListener("change", openCell);
scene = makeScene(find("scene"));

// ------------------------------------------------------------------------------------------------------------- maps

function drawMaps() {
  const body = find("maps-body");
  if (!data.maps.length) {
    body.append(element("p", { text: data.words.no_maps }));
    return;
  }
  const names = [...new Set(data.maps.flatMap((map) => map.policies.map((one) => one.name)))];
  for (const id of new Set(data.maps.map((map) => map.id))) {
    body.append(element("h3", { text: id }));
    const charts = element("div", { class: "charts" });
    for (const map of data.maps.filter((one) => one.id === id)) {
      const figure = element("figure");
      const best = { name: "best found", values: map.bests, plain: true };
      const policies = map.policies.map((one) => ({ ...one, style: names.indexOf(one.name) })); // in all maps the same
      const series = [...(map.bests.some((value) => value !== null) ? [best] : []), ...policies];
      figure.append(element("figcaption", { text: `Payload [kg] against ${map.label}` }),
        lineChart({ x: map.x, series, points: true, log: true, range: [0, 1.05 * Math.max(0.1, ...series.flatMap((one) => one.values.filter((value) => value !== null)))], label: `Payload against ${map.label}, ${id}` }).node,
        numbers(map, series));
      charts.append(figure);
    }
    body.append(charts);
  }
}

function numbers(map, series) {
  const details = element("details"), table = element("table"), head = element("tr"), box = element("div", { class: "wide" });
  head.append(element("th", { scope: "col", text: map.label }), ...map.x.map((value) => element("th", { scope: "col", class: "number", text: String(value) })));
  table.append(head);
  for (const one of series) {
    const row = element("tr");
    row.append(element("th", { scope: "row", text: one.name }), ...one.values.map((value) => element("td", { class: "number", text: value === null ? "–" : value.toFixed(2) })));
    table.append(row);
  }
  box.append(table);
  details.append(element("summary", { text: "The numbers" }), box);
  return details;
}

// ------------------------------------------------------------------------------------------------------------ start

for (const part of data.made) {
  const list = element("ul");
  list.append(...part.lines.map((line) => element("li", { text: line })));
  find("made-body").append(element("h3", { text: part.title }), list);
}
const board = makeBoard(data.rows, open);
drawMaps();
const linked = data.rows.find((row) => row.key === decodeURIComponent(location.hash.slice(1)));
const start = linked ?? data.rows.find((row) => data.cells[row.cells[0]].replays) ?? data.rows[0];
board.filters.id.value = start.id;
board.filters.motion.value = start.motion;
board.filters.condition.value = start.condition;
open(start, false);
