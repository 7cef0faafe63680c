// For each policy: when along the motion each kind of limit broke, as a table with a histogram in each row.

function limitFigure(entry) {
  const figure = element("figure"), table = element("table", { class: "limits" }), head = element("tr");
  for (const title of ["limit", "start", "count", "lead [s]"]) head.append(element("th", { scope: "col", text: title }));
  head.children[1].append(element("span", { text: "end" }));
  table.append(head);
  const highest = Math.max(...entry.strips.flatMap((strip) => strip.counts));
  for (const strip of entry.strips) {
    const row = element("tr"), cell = element("td", { class: "strip" });
    cell.append(histogram(strip, highest));
    row.append(element("th", { scope: "row", text: strip.limit }), cell, element("td", { class: "number", text: String(strip.count) }),
      element("td", { class: "number", text: strip.lead === null ? "–" : strip.lead.toFixed(strip.lead < 0.1 ? 3 : 2) }));
    table.append(row);
  }
  figure.append(element("figcaption", { text: entry.policy }), table);
  return figure;
}

// For one policy: the payload with each error of an uncertainty alone.

function errorFigure(entry) {
  const figure = element("figure"), table = element("table", { class: "limits" });
  const largest = Math.max(...entry.bars.map((bar) => bar.payload)) || 1;
  for (const bar of entry.bars) {
    const row = element("tr"), cell = element("td", { class: "strip" });
    const picture = drawing("svg", { viewBox: "0 0 1 1", preserveAspectRatio: "none", role: "img", "aria-label": `${bar.error}: ${bar.text}` });
    picture.append(drawing("rect", { x: 0, y: 0.1, width: bar.payload / largest, height: 0.8 }));
    cell.append(picture);
    row.append(element("th", { scope: "row", text: bar.error }), cell, element("td", { class: "number", text: bar.text }));
    table.append(row);
  }
  figure.append(element("figcaption", { text: entry.title }), table);
  return figure;
}

function histogram(strip, highest) {
  const bins = strip.counts.length, label = `${strip.limit}: ${strip.count} violations, median at ${percent(strip.fraction)} of the motion`;
  const picture = drawing("svg", { viewBox: `0 0 ${bins} 1`, preserveAspectRatio: "none", role: "img", "aria-label": label });
  strip.counts.forEach((count, bin) => {
    const height = count / highest, bar = drawing("rect", { x: bin + 0.08, width: 0.84, y: 1 - height, height });
    bar.append(drawing("title", {}, `${count} of ${strip.count} from ${percent(bin / bins)} to ${percent((bin + 1) / bins)} of the motion`));
    picture.append(bar);
  });
  return picture;
}
