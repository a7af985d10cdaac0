"use strict";
// Draws the charts one after the other, so that the page can be read and scrolled meanwhile.
(() => {
  const content = (id) => JSON.parse(document.getElementById(id).textContent);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const shared = content("shared");
  const plots = [...document.querySelectorAll(".plot")];
  const isTouch = !matchMedia("(hover: hover) and (pointer: fine)").matches;  // a finger shall scroll the page, not zoom
  const config = { responsive: true, displaylogo: false, displayModeBar: isTouch ? false : "hover",
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]] };
  let isZooming = false;

  // Numbers of events, as far as there is room for them.
  function labels(width) {
    if (!shared.range) return [];
    const span = shared.range[1] - shared.range[0] || 1;
    let last = -Infinity;
    return shared.labels.filter(([time]) => {
      const place = ((time - shared.range[0]) / span) * (width - 70);
      if (place - last < 20) return false;
      last = place;
      return true;
    }).map(([time, text]) => ({ x: time, y: 1, xref: "x", yref: "paper", yanchor: "bottom", text, showarrow: false,
      font: { size: 12, color: colour("--soft") } }));
  }

  function inks() {
    const axis = { gridcolor: colour("--grid"), zerolinecolor: colour("--rule"), linecolor: colour("--rule") };
    return { axis, font: { size: 12, color: colour("--ink"), family: "system-ui, DejaVu Sans, sans-serif" } };
  }

  function draw(plot) {
    const { traces, axis, over, x, shapes } = content(plot.id + "-data");
    const ink = inks(), isTime = over === "time";
    const hasLegend = traces.some((trace) => trace.name && trace.showlegend !== false && trace.type === "scatter");
    const layout = {
      font: ink.font, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      margin: { l: 52, r: 12, t: isTime && shared.labels.length ? 20 : 10, b: hasLegend ? 62 : 40 },
      xaxis: { ...ink.axis, title: { text: x, font: { size: 12 }, standoff: 4 },
        ...(isTime && shared.range ? { range: shared.range } : {}) },
      yaxis: { ...ink.axis, automargin: true, ...axis },
      shapes: isTime ? [...shared.marks, ...shapes] : shapes,
      annotations: isTime ? labels(plot.clientWidth) : [],
      hovermode: isTime ? "x unified" : "closest", dragmode: isTouch ? false : "zoom",
      hoverlabel: { font: { size: 12, color: colour("--ink") }, bgcolor: colour("--paper") },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--soft"), activecolor: colour("--link") },
      showlegend: hasLegend, legend: { orientation: "h", x: 0, y: -0.22, yanchor: "top", font: { size: 12 } },
    };
    plot.dataset.over = over;
    return Plotly.newPlot(plot, traces, layout, config).then(() => {
      if (isTime) plot.on("plotly_relayout", (change) => follow(plot, change));
    });
  }

  // All charts over time show the same stretch of it.
  function follow(from, change) {
    if (isZooming) return;
    const low = change["xaxis.range[0]"], high = change["xaxis.range[1]"];
    if (low === undefined && !change["xaxis.autorange"]) return;
    const range = low === undefined ? shared.range : [low, high];
    isZooming = true;
    Promise.all(plots.filter((plot) => plot !== from && plot.dataset.over === "time")
      .map((plot) => Plotly.relayout(plot, { "xaxis.range": [...range] })))
      .finally(() => { isZooming = false; });
  }

  function recolour() {
    const ink = inks(), change = { "font.color": ink.font.color, "hoverlabel.bgcolor": colour("--paper"),
      "hoverlabel.font.color": ink.font.color };
    for (const axis of ["xaxis", "yaxis"]) {
      for (const [name, value] of Object.entries(ink.axis)) change[`${axis}.${name}`] = value;
    }
    for (const plot of plots) if (plot.dataset.over) Plotly.relayout(plot, change);
  }

  for (const button of document.querySelectorAll(".wheels button")) {
    button.addEventListener("click", () => {
      const isShown = button.getAttribute("aria-pressed") !== "true", wheel = button.dataset.wheel;
      for (const twin of document.querySelectorAll(".wheels button")) {
        if (twin.dataset.wheel === wheel) twin.setAttribute("aria-pressed", String(isShown));
      }
      for (const plot of plots) {
        const which = (plot.data || []).map((trace, index) => (trace.legendgroup === wheel ? index : -1))
          .filter((index) => index >= 0);
        if (which.length) Plotly.restyle(plot, { visible: isShown }, which);
      }
    });
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
  matchMedia("print").addEventListener("change", recolour);

  (async () => {
    for (const plot of plots) {
      await draw(plot);
      await new Promise((done) => setTimeout(done));
    }
    document.documentElement.dataset.drawn = "all";
  })();
})();
