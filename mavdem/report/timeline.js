// The timeline: one uPlot chart a row, zoomed and read together; modes, events and training data go through all rows.
(() => {
  const root = document.getElementById("timeline"), data = JSON.parse(document.getElementById("timeline-data").textContent);
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const unpack = ([low, step, counts]) => Array.from(new Int16Array(Uint8Array.from(atob(counts), c => c.charCodeAt(0)).buffer),
    count => count === -32768 ? null : low + step * (count + 32767));
  const [first, last] = data.span, charts = [], tints = ["#1f7ad633", "#12997a33", "#b5852a33", "#9461d133"];
  const digits = value => value == null ? "–" : Number(value.toPrecision(4)).toString();
  const names = [...new Set(data.modes.map(mode => mode[2]))];
  const font = "11px system-ui, sans-serif", size = 52, edge = 14;
  let zooming = false;

  const behind = (chart, strip) => {
    const { ctx, bbox } = chart, ratio = devicePixelRatio, at = time => chart.valToPos(time, "x", true);
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    if (!strip) {
      ctx.fillStyle = colour("--quote");
      for (const [start, end] of data.trained) ctx.fillRect(at(start), bbox.top, at(end) - at(start), bbox.height);
    }
    for (const [start, end, name] of data.modes) {
      const left = Math.max(at(start), bbox.left), width = Math.min(at(end), bbox.left + bbox.width) - left;
      if (strip && width > 0) {
        ctx.fillStyle = tints[names.indexOf(name) % tints.length];
        ctx.fillRect(left, bbox.top, width - ratio, bbox.height);
        ctx.save();
        ctx.beginPath(); ctx.rect(left, bbox.top, width - 2 * ratio, bbox.height); ctx.clip();
        ctx.fillStyle = colour("--ink"); ctx.font = `${11 * ratio}px system-ui, sans-serif`; ctx.textBaseline = "middle";
        ctx.fillText(name, left + 4 * ratio, bbox.top + bbox.height / 2);
        ctx.restore();
      }
    }
    ctx.lineWidth = ratio; ctx.setLineDash([4 * ratio, 3 * ratio]);
    for (const [time, alarm] of data.events) {
      ctx.strokeStyle = colour(alarm ? "--bad" : "--soft");
      ctx.beginPath(); ctx.moveTo(at(time), bbox.top); ctx.lineTo(at(time), bbox.top + bbox.height); ctx.stroke();
    }
    ctx.restore();
  };

  const zoom = (min, max) => {
    if (zooming) return;
    zooming = true;
    for (const chart of charts) chart.setScale("x", { min, max });
    zooming = false;
    root.dataset.zoom = `${min} ${max}`;
  };

  const add = (row, place) => {
    const strip = !row, series = [{}], bands = [];
    let columns = [[first, last]], wide = 0;
    if (row) {
      const lines = row.lines.map(([name, stroke, values, half]) => [name, stroke, unpack(values), half && unpack(half)]);
      columns = [lines[0][2].map((_, i) => row.times[0] + row.times[1] * i)];
      for (const [label, stroke, values, half] of lines) {
        if (half) wide = Math.max(wide, half.filter(Number.isFinite).sort((a, b) => a - b)[half.length >> 1] || 0);
        if (half) for (const sign of [1, -1]) {
          columns.push(values.map((value, i) => value == null ? null : value + sign * half[i]));
          series.push({ class: "edge", stroke: "transparent", points: { show: false }, auto: false });
        }
        if (half) bands.push({ series: [series.length - 2, series.length - 1], fill: stroke + "38" });
        columns.push(values);
        series.push({ label, stroke, width: 1.2, points: { show: false }, value: (_, value) => digits(value) });
      }
    }
    const end = row && place === data.rows.length - 1, ink = () => colour("--ink"), grid = { stroke: () => colour("--line"), width: 1 };
    const axis = { stroke: ink, font, grid, ticks: grid };
    const chart = new uPlot({
      width: root.clientWidth, height: strip ? 26 : end ? 150 : 123, series, bands,
      padding: [strip ? 2 : 18, edge, strip || end ? 0 : 7, 0],
      scales: { x: { time: false, range: (_, min, max) => [Math.max(min, first), Math.min(max, last)] }, y: { range: (_, min, max) => {
        if (min == null) return [0, 1];
        const room = Math.min(wide, 0.6 * (max - min));
        const [low, high] = uPlot.rangeNum(min - room, max + room, 0.05, false);
        return [min < 0 ? low : Math.max(low, 0), high];
      } } },
      axes: [
        { ...axis, size: end ? 42 : 0, show: !strip, label: end ? "time since boot (s)" : undefined, labelSize: 16, labelFont: font, labelGap: 0,
          values: end ? undefined : (_, splits) => splits.map(() => "") },
        { ...axis, size, grid: { ...grid, show: !strip }, ticks: { ...grid, show: !strip }, values: strip ? (_, splits) => splits.map(() => "") : (_, splits) => splits.map(digits) },
      ],
      legend: { show: !strip }, select: { show: true },
      cursor: { y: false, sync: { key: "flight" }, drag: { x: true, y: false } },
      hooks: {
        drawClear: [chart => behind(chart, strip)],
        setScale: [(chart, key) => key === "x" && charts.includes(chart) && zoom(chart.scales.x.min, chart.scales.x.max)],
      },
    }, columns, root);
    if (row) chart.root.insertAdjacentHTML("afterbegin", `<div class="u-row"></div>`);
    if (row) chart.root.firstChild.textContent = row.title;
    charts.push(chart);
  };

  document.documentElement.classList.add("plotted");
  root.charts = charts;
  if (data.modes.length) add(null, 0);
  data.rows.forEach(add);
  new ResizeObserver(() => charts.forEach(chart => root.clientWidth && chart.setSize({ width: root.clientWidth, height: chart.height }))).observe(root);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach(chart => chart.redraw(false, true)));
  document.getElementById("whole").addEventListener("click", () => zoom(first, last));
  for (const row of document.querySelectorAll("[data-at]")) row.addEventListener("click", () => {
    zoom(Math.max(row.dataset.at - 5, first), Math.min(+row.dataset.at + 5, last));
    root.scrollIntoView({ block: "nearest" });
  });
})();
