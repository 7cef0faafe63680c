// Connects the leaderboard and the episode view. Selecting a row of the leaderboard opens its episode.

const data = JSON.parse(document.getElementById("data").textContent);
const find = (id) => document.getElementById(id);

// ----------------------------------------------------------------------------------------------------- colour theme

const dark = matchMedia("(prefers-color-scheme: dark)");
const THEMES = ["system", "light", "dark"];
let theme = "system";
try { theme = localStorage.getItem("cablebot-theme") ?? "system"; } catch { /* storage may be unavailable for a local file */ }

function paintTheme() {
  document.documentElement.dataset.theme = theme === "system" ? (dark.matches ? "dark" : "light") : theme;
  find("theme").setAttribute("aria-label", `Colour theme: ${theme}`);
  scene?.draw();
}

find("theme").addEventListener("click", () => {
  theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
  try { localStorage.setItem("cablebot-theme", theme); } catch { /* see above */ }
  paintTheme();
});
dark.addEventListener("change", paintTheme);

// ---------------------------------------------------------------------------------------------------------- episode

let scene = null, charts = [], animation = null, requestCount = 0;
paintTheme();

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new DataView(await new Response(stream).arrayBuffer());
}

async function unpackChannels(replay) {
  const view = await inflate(replay.data), channels = {};
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

function openRow(row, scroll) {
  stop();
  leaderboard.mark(row);
  find("episode-title").textContent = `${row.policy} on ${row.id}, ${row.motion}, ${row.condition}`;
  const motions = find("motion");
  motions.replaceChildren(...row.cells.map((index) => element("option", { value: String(index), text: data.cells[index].title })));
  find("motion-choice").hidden = row.cells.length < 2;
  history.replaceState(null, "", `#${encodeURIComponent(row.key)}`);
  openCell();
  if (scroll) find("episode").scrollIntoView();
}

function openCell() {
  const cell = data.cells[Number(find("motion").value)];
  const recipe = find("recipe"), facts = element("dl");
  for (const [term, text] of cell.facts) facts.append(element("dt", { text: term }), element("dd", { text }));
  recipe.replaceChildren(element("pre", { text: cell.code }), facts);
  find("replay").hidden = !cell.replays;
  if (!cell.replays) {
    find("verdict").className = "";
    find("verdict").textContent = cell.reason;
    return;
  }
  find("payloads").replaceChildren(...cell.replays.map((replay, index) => {
    const label = element("label"), choice = element("input", { type: "radio", name: "payload", value: String(index) });
    choice.checked = index === 0;
    choice.addEventListener("change", () => showReplay(cell, replay));
    label.append(choice, `${replay.payload.toFixed(2)} kg, ${index ? "above the DLCC" : cell.payload_label}`);
    return label;
  }));
  showReplay(cell, cell.replays[0]);
}

async function showReplay(cell, replay) {
  stop();
  const request = ++requestCount, frames = await unpackChannels(replay);
  if (request !== requestCount) return;  // a later selection replaces this one
  const robot = data.robots[cell.robot], motion = data.motions[cell.motion];
  const verdict = find("verdict");
  verdict.className = replay.carried ? "good" : "bad";
  verdict.textContent = replay.carried ? `${replay.payload.toFixed(2)} kg: carried` : `${replay.payload.toFixed(2)} kg: ${replay.violation}`;
  scene.show(robot, frames, motion);
  drawCharts(frames, motion, robot, replay.violation_time);
  find("tension-scale").textContent = `0 to ${robot.fullTension.toFixed(0)} N`;
  const slider = find("time");
  slider.max = String(frames.times.length - 1);
  slider.value = "0";
  find("replay").frames = frames;
  moveTo(0);
}

const SATURATED = 0.999;  // |action| that counts as saturated; clipped actions reach 1 up to the 16-bit quantisation

function drawCharts(frames, motion, robot, violationTime) {
  const column = (name, index, scale = 1) => frames[name].map((values) => scale * values[index]);
  const motors = robot.base.map((_, motor) => {
    const values = column("action", motor), saturated = values.filter((value) => Math.abs(value) >= SATURATED).length / values.length;
    const peak = values.reduce((largest, value) => (Math.abs(value) > Math.abs(largest) ? value : largest), 0);
    return { name: `motor ${motor + 1}`, values, note: `peak ${peak.toFixed(2)}${saturated ? `, saturated ${percent(saturated)} of the time` : ""}` };
  });
  const cables = robot.base.map((_, cable) => ({ name: `cable ${cable + 1}`, values: column("tension", cable) }));
  const range = Math.min(3, Math.max(1.2, ...motors.flatMap((motor) => motor.values.map(Math.abs))));
  const error = (name, scale, bound) => {
    const values = column(name, 0, scale);
    return { x: frames.times, series: [{ name: "error", values, plain: true, note: `maximum ${Math.max(...values).toFixed(2)}, bound ${bound}` }],
      range: [0, Math.max(1.25 * bound, Math.min(3 * bound, ...[Math.max(...values)]))], bounds: [bound], tube: [0, bound] };
  };
  const plots = {
    "chart-action": { x: frames.times, series: motors, range: [-range, range], bounds: [-1, 1], label: "Action of each motor over time" },
    "chart-position": { ...error("position_error", 1e3, 1e3 * motion.bound), label: "Position error over time" },
    "chart-tension": { x: frames.times, series: cables, bounds: [robot.leastTension], label: "Tension of each cable over time",
      range: [Math.min(0, ...cables.flatMap((cable) => cable.values)), Math.max(1, ...cables.flatMap((cable) => cable.values))] },
  };
  find("figure-rotation").hidden = !frames.rotation_error;
  if (frames.rotation_error) plots["chart-rotation"] = { ...error("rotation_error", 1e3, 1e3 * motion.rotation), label: "Rotation error over time" };
  charts = Object.entries(plots).map(([id, options]) => {
    const chart = lineChart({ ...options, event: violationTime });
    find(id).replaceChildren(chart.node);
    return chart;
  });
}

function moveTo(frame) {
  const frames = find("replay").frames, time = frames.times[frame];
  find("time").value = String(frame);
  find("time").setAttribute("aria-valuetext", `${time.toFixed(2)} s`);
  find("clock").textContent = `${time.toFixed(2)} s`;
  scene.showFrame(frame);
  for (const chart of charts) chart.moveCursor(time);
}

function stop() {
  if (animation !== null) cancelAnimationFrame(animation);
  animation = null;
  find("play").textContent = "Play";
  find("play").setAttribute("aria-pressed", "false");
}

function play() {
  const frames = find("replay").frames, last = frames.times.length - 1;
  let time = Number(find("time").value) >= last ? 0 : frames.times[Number(find("time").value)], previous = null;
  find("play").textContent = "Stop";
  find("play").setAttribute("aria-pressed", "true");
  const step = (now) => {
    if (previous !== null) time += (now - previous) / 1000 * Number(find("speed").value);
    previous = now;
    const frame = Math.min(last, Math.floor(time * data.rate));
    moveTo(frame);
    if (frame < last) animation = requestAnimationFrame(step);
    else stop();
  };
  animation = requestAnimationFrame(step);
}

find("play").addEventListener("click", () => (animation === null ? play() : stop()));
find("time").addEventListener("input", () => { stop(); moveTo(Number(find("time").value)); });
find("motion").addEventListener("change", openCell);
scene = makeScene(find("scene"));

// ------------------------------------------------------------------------------------------------------------ start

for (const section of data.notes) {
  const list = element("ul");
  list.append(...section.lines.map((line) => element("li", { text: line })));
  find("notes-body").append(element("h3", { text: section.title }), list);
}
const leaderboard = makeLeaderboard(data.rows, openRow);
const linked = data.rows.find((row) => row.key === decodeURIComponent(location.hash.slice(1)));
const start = linked ?? data.rows.find((row) => data.cells[row.cells[0]]?.replays) ?? data.rows[0];
leaderboard.filters.id.value = start.id;
leaderboard.filters.motion.value = start.motion;
leaderboard.filters.condition.value = start.condition;
openRow(start, false);
