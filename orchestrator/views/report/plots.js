// The panels over time: each is drawn when it comes near the screen; all share one window of time.

const panels = []; // {panel, element, drawn, cursor}
const whole = [Infinity, -Infinity];
let shownWindow = null; // [from, to] in s; null is the whole run
const MARGIN = 0.06; // of the extent, above and below the curves

function span() {
  return shownWindow ?? whole;
}

/** What the vertical axis shows: all visible curves within the window, a little more, and no less than `least`. */
function extent(panel, [from, to]) {
  let low = Infinity, high = -Infinity;
  for (const curve of panel.curves) {
    if (!shows(curve.keys)) continue;
    const last = curve.t.length - 1;
    const first = indexAt(curve.t, from), end = Math.min(last, indexAt(curve.t, to) + 1);
    for (let i = first; i <= end; i++) {
      if (curve.y[i] < low) low = curve.y[i];
      if (curve.y[i] > high) high = curve.y[i];
    }
    if (!curve.band || !shows(["band"])) continue;
    const { edges, least, greatest } = curve.band;
    for (let k = indexAt(edges, from); k < least.length && edges[k] < to; k++) {
      if (least[k] < low) low = least[k];
      if (greatest[k] > high) high = greatest[k];
    }
  }
  if (low > high) [low, high] = [-1, 1];
  const least = Math.max(panel.least, 1e-12, 1e-6 * Math.max(Math.abs(low), Math.abs(high)));
  const more = Math.max(0, (least - (high - low)) / 2) + MARGIN * Math.max(high - low, least);
  return panel.down ? [high + more, low - more] : [low - more, high + more];
}

/** The outline of a band, from step to step there and back; each stretch without a gap is closed by itself. */
function outline({ edges, least, greatest }) {
  const x = [], y = [];
  for (let first = 0; first < least.length; ) {
    if (Number.isNaN(least[first])) { first++; continue; }
    let end = first;
    while (end < least.length && !Number.isNaN(least[end])) end++;
    for (let k = first; k < end; k++) { x.push(edges[k], edges[k + 1]); y.push(greatest[k], greatest[k]); }
    for (let k = end - 1; k >= first; k--) { x.push(edges[k + 1], edges[k]); y.push(least[k], least[k]); }
    x.push(edges[first], null);
    y.push(greatest[first], null);
    first = end;
  }
  return { x, y };
}

function bandTrace(curve) {
  const colour = curve.desired ? ink("reference") : tone(curve.colour);
  return {
    type: "scatter", mode: "lines", ...outline(curve.band), fill: "toself", fillcolor: faint(colour, 0.28),
    line: { color: faint(colour, 0.4), width: 0.8 }, visible: shows([...curve.keys, "band"]), showlegend: false, hoverinfo: "skip",
    zorder: -1, // below all lines
  };
}

function traces(panel) {
  const lines = panel.curves.map((curve) => ({
    type: "scatter", mode: curve.t.length === 1 ? "markers" : "lines", name: curve.name, x: curve.t, y: curve.y,
    visible: shows(curve.keys), showlegend: panel.legend, hovertemplate: "%{y:.5g}",
    line: curve.desired ? { color: ink("reference"), width: 1.1, dash: "5px,4px" } : { color: tone(curve.colour), width: 1.6 },
  }));
  return lines.concat(panel.curves.filter((curve) => curve.band).map(bandTrace));
}

function layout(panel) {
  const axis = {
    gridcolor: ink("grid"), linecolor: ink("line"), zerolinecolor: ink("line"), zerolinewidth: 1, tickfont: { size: 11 },
    exponentformat: "power", nticks: 6,
  };
  const window = span();
  return {
    margin: { l: 54, r: 10, t: 6, b: 26 }, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: ink("soft"), family: getComputedStyle(document.body).fontFamily }, showlegend: panel.legend,
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", font: { size: 11 } },
    hovermode: "x unified", dragmode: isTouch ? false : "zoom",
    hoverlabel: { bgcolor: ink("paper"), bordercolor: ink("line"), font: { color: ink("ink"), size: 11 } },
    xaxis: { ...axis, range: [...window], zeroline: false, unifiedhovertitle: { text: "%{x:.3f} s" } },
    yaxis: { ...axis, range: extent(panel, window), fixedrange: true, nticks: 5 },
  };
}

const config = {
  responsive: true, displaylogo: false, doubleClick: false, scrollZoom: false,
  modeBarButtons: [["toImage"]], displayModeBar: isTouch ? false : "hover",
};

function draw(entry) {
  if (entry.drawn) return;
  entry.drawn = true;
  Plotly.newPlot(entry.element, traces(entry.panel), layout(entry.panel), config);
  entry.element.on("plotly_relayout", (change) => {
    const from = change["xaxis.range[0]"], to = change["xaxis.range[1]"];
    if (from !== undefined && to !== undefined) show([Number(from), Number(to)]);
  });
  entry.element.on("plotly_doubleclick", () => show(null));
  entry.element.on("plotly_click", (click) => seek(Number(click.points[0].x)));
  entry.element.on("plotly_afterplot", () => mark(entry));
  mark(entry);
}

/** Show a window [from, to] of time in s in all panels, or with null the whole run. */
function show(window) {
  const same = (a, b) => a === b || (a && b && a[0] === b[0] && a[1] === b[1]);
  if (window && !(window[0] < window[1])) return;
  if (same(window, shownWindow)) return;
  shownWindow = window && [...window];
  fillWindow();
  for (const entry of panels) if (entry.drawn) fit(entry);
}

function fit(entry) {
  Plotly.relayout(entry.element, { "xaxis.range": [...span()], "yaxis.range": extent(entry.panel, span()) });
}

function fillWindow() {
  const [from, to] = span();
  find("from").value = Number(from.toPrecision(6));
  find("to").value = Number(to.toPrecision(6));
}

/** Hide or show all curves that have a key. */
function toggle(key) {
  if (!hidden.delete(key)) hidden.add(key);
  for (const entry of panels) if (entry.drawn) repaint(entry);
  redrawScene();
}

function repaint(entry) {
  Plotly.react(entry.element, traces(entry.panel), layout(entry.panel), config);
}

let now = 0; // s, of the replay

/** Put the line of the replay's time into a panel. */
function mark(entry) {
  const full = entry.element._fullLayout;
  if (!data.replay || !full?.xaxis) return;
  const [from, to] = full.xaxis.range, { l, t, w, h } = full._size;
  const inside = now >= from && now <= to;
  entry.cursor.style.display = inside ? "block" : "none";
  if (!inside) return;
  entry.cursor.style.height = `${h}px`;
  entry.cursor.style.transform = `translate(${entry.element.offsetLeft + l + (w * (now - from)) / (to - from)}px, ${entry.element.offsetTop + t}px)`;
}

function makeLegend() {
  for (const { key, label, colour, shape } of data.keys) {
    const chip = make("i", { class: shape ? `chip ${shape}` : "chip", "data-colour": JSON.stringify(colour) });
    const button = make("button", { type: "button", "aria-pressed": "true", "data-key": key }, chip, label);
    button.addEventListener("click", () => {
      toggle(key);
      button.setAttribute("aria-pressed", String(!hidden.has(key)));
    });
    find("legend").append(button);
  }
  paintChips();
}

function makePanels() {
  const near = new IntersectionObserver((seen) => {
    for (const { isIntersecting, target } of seen) {
      if (!isIntersecting) continue;
      near.unobserve(target);
      draw(panels[Number(target.dataset.panel)]);
    }
  }, { rootMargin: "200px" });
  for (const group of data.groups) {
    const grid = make("div", { class: "panels" });
    find("groups").append(make("h3", {}, group.title + " ", make("small", {}, group.note)), grid);
    for (const panel of group.panels) {
      const caption = panel.name + (panel.unit ? ` [${panel.unit}]` : "");
      const element = make("div", { class: "plot", "data-panel": panels.length, role: "img", "aria-label": `${group.title}: ${caption} over time` });
      const cursor = make("div", { class: "cursor", "aria-hidden": "true" });
      grid.append(make("figure", { class: "panel" }, make("figcaption", {}, caption), element, cursor));
      panels.push({ panel, element, cursor, drawn: false });
      for (const { t } of panel.curves) {
        whole[0] = Math.min(whole[0], t[0]);
        whole[1] = Math.max(whole[1], t[t.length - 1]);
      }
      near.observe(element);
    }
  }
  if (whole[0] === whole[1]) whole[1] += 1; // a run of one row
}

if (data.groups.length) {
  find("plots").hidden = false;
  makeLegend();
  makePanels();
  fillWindow();
  for (const id of ["from", "to"]) {
    find(id).addEventListener("change", () => {
      const window = [find("from").valueAsNumber, find("to").valueAsNumber];
      if (window[0] < window[1]) show(window);
      else fillWindow();
    });
  }
  find("whole").addEventListener("click", () => show(null));
  darkness.addEventListener("change", () => panels.filter((entry) => entry.drawn).forEach(repaint));
  addEventListener("beforeprint", () => panels.forEach(draw));
  onSeek.push((t) => {
    now = t;
    for (const entry of panels) if (entry.drawn) mark(entry);
  });
}

for (const section of document.querySelectorAll("main section")) {
  if (section.id === "replay" ? data.replay : !section.hidden) {
    document.querySelector("nav").append(make("a", { href: `#${section.id}` }, section.querySelector("h2").textContent));
  }
}
