// DOM helpers and SVG charts. Lines differ in their dashes and in their colours, which are those of Okabe and Ito.

const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8a7d00", "#7a7a7a"];
const DASHES = ["", "7 3", "2 3", "9 3 2 3", "4 2", "12 4", "1 2", "6 2 1 2 1 2"];

function element(name, attributes = {}) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "text") made.textContent = value;
    else if (value !== "" || key === "value") made.setAttribute(key, value);
  }
  return made;
}

function drawing(name, attributes = {}, text = null) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== null) made.textContent = text;
  return made;
}

const percent = (fraction) => `${Math.round(100 * fraction)}%`;

function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5, 10].find((times) => times * power >= raw) ?? 10);
  const values = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9 * step; value += step) values.push(Number(value.toPrecision(10)));
  return values;
}

/* options: x (numbers), series ([{name, values, note, plain}]), label, range ([low, high] of y), bounds ([y]), tube ([low, high]),
   event (x of a vertical line, or null). Returns {node, moveCursor(x)}. */
function lineChart(options) {
  const width = 520, height = 230, left = 46, right = 10, top = 8, bottom = 26;
  const { x, series } = options, first = x[0], span = x[x.length - 1] - first || 1;
  const [low, high] = options.range;
  const across = (value) => left + (value - first) / span * (width - left - right);
  const down = (value) => height - bottom - (value - low) / (high - low) * (height - top - bottom);

  const picture = drawing("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": options.label });
  if (options.tube) picture.append(drawing("rect", { class: "tube", x: left, width: width - left - right,
    y: down(Math.min(options.tube[1], high)), height: down(Math.max(options.tube[0], low)) - down(Math.min(options.tube[1], high)) }));
  for (const value of ticks(low, high, 5)) {
    picture.append(drawing("line", { class: "grid", x1: left, x2: width - right, y1: down(value), y2: down(value) }),
      drawing("text", { x: left - 5, y: down(value) + 4, "text-anchor": "end" }, String(value)));
  }
  for (const value of ticks(x[0], x[x.length - 1], 6)) {
    picture.append(drawing("line", { class: "grid", x1: across(value), x2: across(value), y1: top, y2: height - bottom }),
      drawing("text", { x: across(value), y: height - bottom + 16, "text-anchor": "middle" }, String(value)));
  }
  picture.append(drawing("line", { class: "axis", x1: left, x2: width - right, y1: height - bottom, y2: height - bottom }));
  for (const bound of options.bounds ?? []) picture.append(drawing("line", { class: "bound", x1: left, x2: width - right, y1: down(bound), y2: down(bound) }));
  if (typeof options.event === "number") picture.append(drawing("line", { class: "bound", x1: across(options.event), x2: across(options.event), y1: top, y2: height - bottom }));
  series.forEach((line, number) => {
    const points = line.values.map((value, index) => `${across(x[index]).toFixed(1)} ${down(Math.max(low, Math.min(high, value))).toFixed(1)}`);
    picture.append(drawing("path", { class: "curve", d: `M${points.join("L")}`, ...strokeStyle(line, number) }));
  });
  const cursor = drawing("line", { class: "cursor", x1: left, x2: left, y1: top, y2: height - bottom });
  picture.append(cursor);

  const node = element("div");
  node.append(picture);
  if (series.length > 1 || series[0]?.note) {
    const legend = element("ul", { class: "legend" });
    series.forEach((line, number) => {
      const item = element("li"), sample = drawing("svg", { viewBox: "0 0 32 12", "aria-hidden": "true" });
      sample.append(drawing("line", { x1: 0, x2: 32, y1: 6, y2: 6, "stroke-width": 2.5, ...strokeStyle(line, number) }));
      item.append(sample, ` ${line.name}${line.note ? `: ${line.note}` : ""}`);
      legend.append(item);
    });
    node.append(legend);
  }
  return {
    node,
    moveCursor(value) {
      cursor.setAttribute("x1", across(value));
      cursor.setAttribute("x2", across(value));
    },
  };
}

function strokeStyle(line, number) {
  if (line.plain) return { stroke: "currentColor", "stroke-dasharray": "" };
  return { stroke: COLOURS[number % COLOURS.length], "stroke-dasharray": DASHES[number % DASHES.length] };
}
