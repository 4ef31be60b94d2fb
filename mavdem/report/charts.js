// The charts of a page: each figure has its data beside it, and is drawn by uPlot as soon as it has a width. Charts of
// one group are zoomed and read together. The root element has what other scripts use of them, as "charts", and gets the
// events "drawn", "openforpaper" before the charts are drawn for print, and "cursor" with the time under the cursor of the
// flight's charts.
(() => {
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const groups = {}, edge = 12;
  // The number as text, with as many digits as are needed to distinguish ticks that are a step apart.
  const digits = (value, step = 0) => {
    if (value == null) return "";
    const size = Math.abs(value), most = Math.max(4, size && step ? Math.min(Math.floor(Math.log10(size / step)) + 3, 12) : 0);
    const text = size && (size < 1e-3 || size >= 1e6) ? value.toExponential(size < 1e-3 ? 0 : 2).replace("e+", "e") : Number(value.toPrecision(most)).toString();
    return text.replaceAll("-", "−");
  };
  // Ticks of a logarithmic axis that get a label: as many of each power of ten as there is room for on the axis of that
  // number, 0 for the horizontal one, or only every second power.
  const labelledSplits = (chart, splits, axisNumber) => {
    const key = axisNumber ? chart.axes[axisNumber].scale : "x", { min, max } = chart.scales[key];
    const pixelsPerDecade = Math.abs(chart.valToPos(max, key) - chart.valToPos(min, key)) / Math.log10(max / min);
    const isForPaper = root.classList.contains("printing"), room = axisNumber ? (isForPaper ? 11 : 16) : (isForPaper ? 20 : 34);
    // The least distance of two labels, in decades, by the digits of the labels in each decade.
    const choices = [[Math.log10(2), [1, 2, 5]], [Math.log10(3), [1, 3]], [1, [1]]];
    const [, labelledDigits] = choices.find(([distance]) => distance * pixelsPerDecade >= room) ?? [2, []];
    return splits.map(value => {
      const power = Math.floor(Math.log10(value) + 1e-9), size = value / 10 ** power, digit = Math.round(size);
      if (Math.abs(size - digit) > 0.01) return null;
      return (labelledDigits.length ? labelledDigits.includes(digit) : digit === 1 && power % 2 === 0) ? value : null;
    });
  };
  // Ticks of a logarithmic axis at round values: uPlot's own begin at the least value.
  const logarithmicSplits = (_, axis, min, max) => {
    const splits = [];
    for (let power = Math.floor(Math.log10(min)); 10 ** power <= max; power++)
      for (let digit = 1; digit < 10; digit++) splits.push(digit * 10 ** power);
    return splits.filter(value => value >= min && value <= max);
  };
  // The rules of the page's style for print and for some screens, by their media.
  const mediaRules = [...document.styleSheets].flatMap(sheet => [...sheet.cssRules]).filter(rule => rule instanceof CSSMediaRule).map(rule => ({ media: rule.media, text: rule.media.mediaText }));
  // While a page is laid out for paper, the screen has the style of print: plots are drawn before the paper has a width,
  // and canvases keep the size that they were drawn with.
  const layOut = isForPaper => {
    root.classList.toggle("printing", isForPaper);
    for (const { media, text } of mediaRules) {
      if (text === "print") media.mediaText = isForPaper ? "all" : text;
      if (text.startsWith("screen and")) media.mediaText = isForPaper ? "not all" : text;
    }
    repaint();
  };
  const font = () => `${root.classList.contains("printing") ? 9 : 11}px system-ui, sans-serif`, root = document.documentElement;

  const unpack = (packed, log) => {
    if (!packed || Array.isArray(packed)) return packed;
    const { low, step, size, counts } = packed, shown = value => log ? 10 ** value : value;
    if (size) return Array.from({ length: size }, (_, i) => shown(low + step * i));
    return Array.from(new Int16Array(Uint8Array.from(atob(counts), c => c.charCodeAt(0)).buffer),
      count => count === -32768 ? null : shown(low + step * (count + 32767)));
  };

  // Values of a line: uPlot takes undefined for "no sample of this line", across which it draws, and null for a gap.
  const withoutSamples = values => values.includes(false) ? values.map(value => value === false ? undefined : value) : values;

  const picture = ({ heat, rows }) => {
    const bytes = Uint8Array.from(atob(heat), c => c.charCodeAt(0)), columns = bytes.length / rows;
    const canvas = Object.assign(document.createElement("canvas"), { width: rows, height: columns });
    const image = new ImageData(rows, columns);
    bytes.forEach((level, i) => {
      const byteIndex = 4 * ((columns - 1 - i % columns) * rows + Math.floor(i / columns));
      image.data.set([31, 122, 214, level], byteIndex);
    });
    canvas.getContext("2d").putImageData(image, 0, 0);
    return canvas;
  };

  const zoom = (group, min, max) => {
    if (group.zooming) return;
    group.zooming = true;
    for (const chart of group.charts) {
      cutPeaks(chart.root.closest("figure"), chart.data_, [min, max]);
      chart.setScale("x", { min, max });
    }
    group.zooming = false;
    group.span = [min, max];
    root.dispatchEvent(new CustomEvent("zoomed", { detail: group }));
  };

  // The modes whose names have no room in the strip, below it.
  const keyOf = (chart, modes) => {
    const plot = chart.root.parentElement, key = plot.parentElement.querySelector(".modes") ?? element("p");
    key.className = "modes soft";
    key.replaceChildren(...modes.map(([name, tint]) => {
      const item = element("span"), patch = element("i");
      patch.style.background = tint;
      item.append(patch, name);
      return item;
    }));
    if (modes.length) plot.after(key); else key.remove();
  };

  // The colours of the modes, in use by turns, which the map of the flown path has too: paler, since their names lie over
  // them, and less so on dark ground.
  const tintsOfModes = () => {
    const opacity = Math.round(255 * Number(colour("--mode-opacity"))).toString(16);
    return colour("--modes").split(" ").map(mode => mode + opacity);
  };

  const drawBackground = (data, chart) => {
    const { ctx, bbox } = chart, ratio = devicePixelRatio, at = x => chart.valToPos(x, "x", true), strip = !data.lines.length;
    const names = [...new Set(data.spans.map(span => span[2]))], named = new Set(), tints = tintsOfModes();
    ctx.save();
    ctx.textAlign = "left";
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    for (const [start, end, name] of data.spans) {
      const left = Math.max(at(start), bbox.left), width = Math.min(at(end), bbox.left + bbox.width) - left;
      if (width <= 0) continue;
      ctx.fillStyle = strip ? tints[names.indexOf(name) % tints.length] : colour("--quote");
      ctx.fillRect(left, bbox.top, width - strip * ratio, bbox.height);
      if (!strip) continue;
      ctx.save();
      ctx.beginPath(); ctx.rect(left, bbox.top, width - 2 * ratio, bbox.height); ctx.clip();
      ctx.fillStyle = colour("--ink"); ctx.font = `${11 * ratio}px system-ui, sans-serif`; ctx.textBaseline = "middle";
      if (ctx.measureText(name).width <= width - 6 * ratio) {
        ctx.fillText(name, left + 4 * ratio, bbox.top + bbox.height / 2);
        named.add(name);
      }
      ctx.restore();
    }
    const { min, max } = chart.scales.x, isInView = name => data.spans.some(([start, end, other]) => other === name && end > min && start < max);
    if (strip) keyOf(chart, names.map((name, i) => [name, tints[i % tints.length]]).filter(([name]) => !named.has(name) && isInView(name)));
    if (data.picture) {
      const [low, high] = data.lines[0].ends, top = chart.valToPos(high, "y", true), left = at(data.columns[0]);
      ctx.imageSmoothingEnabled = false;
      ctx.drawImage(data.picture, left, top, at(data.columns[1]) - left, chart.valToPos(low, "y", true) - top);
    }
    ctx.lineWidth = ratio; ctx.strokeStyle = "#7d8694"; ctx.setLineDash([]);
    for (const level of data.levels) {
      const y = chart.valToPos(level, "y", true);
      ctx.beginPath(); ctx.moveTo(bbox.left, y); ctx.lineTo(bbox.left + bbox.width, y); ctx.stroke();
    }
    ctx.setLineDash([4 * ratio, 3 * ratio]);
    // Of many events those that are no alarms are faint, so that lines stay in sight.
    const marks = drawnMarks(data);
    for (const [x, , stroke] of marks) {
      ctx.strokeStyle = stroke;
      ctx.globalAlpha = marks.length > MANY_MARKS && stroke === "#7d8694" ? 0.4 : 1;
      ctx.beginPath(); ctx.moveTo(at(x), bbox.top); ctx.lineTo(at(x), bbox.top + bbox.height); ctx.stroke();
    }
    ctx.restore();
  };

  // Marks of a chart from which on they are faint: a choice.
  const MANY_MARKS = 20;
  // Pixels above a plot in which its marks stand, where things are counted.
  const MARKS_ABOVE = 13;
  const isDots = line => ["dots", "squares", "joined"].includes(line.kind);
  const isMean = line => isDots(line) && Boolean(line.low);
  // Single values beside means, which have whiskers, are hollow. Otherwise dots of every second colour are rings, so that
  // they differ on grey paper, too; beside squares the shape says more.
  const isRing = (line, lines) => {
    if (!isDots(line)) return false;
    if (lines.some(isMean) && !lines.filter(isDots).every(isMean)) return !isMean(line);
    if (lines.some(other => other.kind === "squares")) return false;
    return [...new Set(lines.filter(isDots).map(other => other.colour))].indexOf(line.colour) % 2 === 1;
  };
  // The numbers of events stand above the plot, where they cover no line. Those that would overlap are one text, such as
  // "3–5, 9", which has the colour of alarms if one of them is an alarm.
  const isOverFlight = data => data.group === "flight" || data.group === "whole flight";
  // The marks to draw. On paper, and on the page of a session, an event is marked only if a list in sight has its text: the
  // longer list may be closed.
  const drawnMarks = data => {
    if (!isOverFlight(data) || !root.classList.contains("printing") && !document.querySelector("#flight.session")) return data.marks;
    const numbers = [...document.querySelectorAll(".events .number")];
    if (!numbers.length) return data.marks;
    const shownNumbers = new Set(numbers.filter(number => number.checkVisibility()).map(number => number.textContent));
    return data.marks.filter(([, name]) => shownNumbers.has(name));
  };
  document.addEventListener("toggle", ({ target }) => {
    if (target.matches("details.events")) for (const chart of groups.flight?.charts ?? []) chart.redraw(false, false);
  }, true);
  const hasNumbers = data => isOverFlight(data) && data.marks.some(([, name]) => name);
  const drawEventNumbers = (data, chart) => {
    const { ctx, bbox } = chart, ratio = devicePixelRatio, right = bbox.left + bbox.width;
    ctx.save();
    ctx.font = `${(root.classList.contains("printing") ? 8 : 10) * ratio}px system-ui, sans-serif`; ctx.textAlign = "left"; ctx.textBaseline = "bottom";
    const events = drawnMarks(data).filter(([, name]) => name).map(([x, name, fill], rank) => ({ left: chart.valToPos(x, "x", true), numbers: [+name], fill, rank }));
    const texts = [];
    const placed = event => {
      const text = rangesOf(event.numbers), width = ctx.measureText(text).width;
      // At the right edge, a text stands left of its line.
      const start = Math.min(event.left - 2 * ratio, right - width);
      return { ...event, text, start, end: start + width + 4 * ratio };
    };
    for (const event of events.filter(({ left }) => left >= bbox.left - 1 && left <= right + 1).sort((one, other) => one.left - other.left)) {
      let text = placed(event);
      while (texts.length && texts.at(-1).end > text.start) {
        const former = texts.pop(), worst = former.rank < text.rank ? former : text;
        text = placed({ left: former.left, numbers: [...former.numbers, ...text.numbers], fill: worst.fill, rank: worst.rank });
      }
      texts.push(text);
    }
    for (const { text, start, fill } of texts) {
      // The colours of the lines are too pale for small letters.
      ctx.fillStyle = colour(fill === "#7d8694" ? "--soft" : "--bad");
      ctx.fillText(text, start, bbox.top - ratio);
    }
    ctx.restore();
  };
  // Whole numbers as text, with runs of them as ranges.
  const rangesOf = numbers => {
    const runs = [];
    for (const number of [...new Set(numbers)].sort((one, other) => one - other)) {
      if (runs.length && runs.at(-1)[1] === number - 1) runs.at(-1)[1] = number; else runs.push([number, number]);
    }
    return runs.map(([first, last]) => first === last ? first : `${first}–${last}`).join(", ");
  };

  // The names of horizontal lines stand on them at the left edge of the plot, where responses are far from their limits.
  const nameLevels = (data, chart) => {
    const { ctx, bbox } = chart, ratio = devicePixelRatio;
    ctx.save();
    ctx.textAlign = "left"; ctx.textBaseline = "bottom";
    data.levels.forEach((level, i) => {
      const name = data.levelNames?.[i];
      if (!name) return;
      const textAndPosition = [name, bbox.left + 3 * ratio, chart.valToPos(level, "y", true) - 2 * ratio];
      ctx.strokeText(...textAndPosition); ctx.fillStyle = colour("--ink"); ctx.fillText(...textAndPosition);
    });
    ctx.restore();
  };

  // Whiskers of dots, stems, and names of marks, which no grid crosses.
  const drawForeground = (data, chart) => {
    const { ctx, bbox } = chart, ratio = devicePixelRatio;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    // Dots of several lines stand beside each other where things are counted.
    // Dots without a whisker beside such dots, as of single flights beside their mean, have places of their own.
    const allDots = data.lines.filter(isDots), dotsWithWhiskers = allDots.filter(line => line.low);
    const dots = dotsWithWhiskers.length ? dotsWithWhiskers : allDots, room = bbox.width / data.x.names.length;
    const dotDistance = data.x.names.length ? Math.min(9 * ratio, 0.8 * room / dots.length) : 0;
    // Where dots have little room, those beside a line with a remark, which is to be followed through them, are pale.
    const isCrowded = dotDistance < 9 * ratio && data.lines.some(line => line.remark);
    for (const line of data.lines) {
      const stems = line.kind === "stems";
      if (!stems && !isDots(line)) continue;
      const alpha = isCrowded && !line.remark ? 0.3 : 1, offset = !dots.includes(line) ? 0 : dotDistance * (dots.indexOf(line) - (dots.length - 1) / 2);
      ctx.strokeStyle = line.colour; ctx.lineWidth = (stems ? 1.6 : 1.1) * ratio;
      if (line.kind === "joined") {
        ctx.beginPath();
        // The line is broken where a value is not known.
        let isBroken = true;
        data.columns.forEach((x, i) => {
          const isKnown = line.y[i] != null;
          if (isKnown) ctx[isBroken ? "moveTo" : "lineTo"](chart.valToPos(x, "x", true) + offset, chart.valToPos(line.y[i], "y", true));
          isBroken = !isKnown;
        });
        ctx.globalAlpha = line.remark ? 1 : 0.45 * alpha;
        ctx.stroke();
      }
      ctx.globalAlpha = alpha;
      data.columns.forEach((x, i) => {
        if (line.y[i] == null) return;
        const left = chart.valToPos(x, "x", true) + offset;
        ctx.beginPath();
        if (!stems) {
          ctx.fillStyle = isRing(line, data.lines) ? colour("--card") : line.colour;
          const top = chart.valToPos(line.y[i], "y", true), size = 2.6 * ratio;
          if (line.kind === "squares") ctx.rect(left - size, top - size, 2 * size, 2 * size);
          else ctx.arc(left, top, size, 0, 7);
          ctx.fill();
          ctx.stroke();
          ctx.beginPath();
          if (!line.low) return;
        }
        ctx.moveTo(left, chart.valToPos(stems ? 0 : line.low[i], "y", true));
        ctx.lineTo(left, chart.valToPos(stems ? line.y[i] : line.high[i], "y", true));
        ctx.stroke();
      });
      ctx.globalAlpha = 1;
    }
    ctx.font = `${(root.classList.contains("printing") ? 8 : 10) * ratio}px system-ui, sans-serif`; ctx.textBaseline = "top";
    ctx.strokeStyle = colour("--card"); ctx.lineWidth = 3 * ratio;
    ctx.textAlign = "left";
    nameLevels(data, chart);
    // Marks of things that are counted stand above the plot, beside the values.
    if (dotDistance) { ctx.restore(); ctx.save(); ctx.font = `${10 * ratio}px system-ui, sans-serif`; ctx.textBaseline = "top"; ctx.strokeStyle = colour("--card"); ctx.lineWidth = 3 * ratio; }
    if (dotDistance) ctx.textAlign = "center";
    if (isOverFlight(data)) {
      ctx.restore();
      drawEventNumbers(data, chart);
      return;
    }
    // Names of marks that would overlap stand one below the other; on an axis of names none do.
    const endsOfRows = [], names = data.marks.filter(([, name]) => name).map(([x, name, fill]) => {
      const width = ctx.measureText(name).width, place = chart.valToPos(x, "x", true);
      // A name that would leave the plot at its right edge ends there.
      const left = dotDistance ? place : Math.min(place + 3 * ratio, bbox.left + bbox.width - width);
      return { name, fill, left, right: left + width };
    });
    for (const { name, fill, left, right } of names.sort((one, other) => one.left - other.left)) {
      const freeRow = endsOfRows.findIndex(end => end < left), row = dotDistance ? 0 : freeRow < 0 ? endsOfRows.length : freeRow;
      endsOfRows[row] = right;
      const textAndPosition = [name, left, bbox.top + ((dotDistance ? -MARKS_ABOVE : 3) + 12 * row) * ratio];
      ctx.strokeText(...textAndPosition); ctx.fillStyle = fill; ctx.fillText(...textAndPosition);
    }
    ctx.restore();
  };

  // Noise of many lines, such as those of all motors, would hide each of them. Where several samples of a line share some
  // pixels, their mean is drawn, over the range from the least to the greatest of them: paler on paper, which may have no
  // colours, so that the dashes of the lines are seen. Means over more pixels would hide a motor that fails within a second.
  const PIXELS_OF_MEAN = 4, LEAST_SAMPLES_OF_MEAN = 3, linearPaths = uPlot.paths.linear();
  const meanAndRange = (chart, seriesNumber, first, last) => {
    const size = Math.floor((last - first + 1) * PIXELS_OF_MEAN * devicePixelRatio / chart.bbox.width);
    if (size < LEAST_SAMPLES_OF_MEAN) return { ...linearPaths(chart, seriesNumber, first, last), fill: null };
    const times = chart.data[0], values = chart.data[seriesNumber], { scale } = chart.series[seriesNumber], mean = new Path2D(), range = new Path2D();
    const place = (time, value) => [chart.valToPos(time, "x", true), chart.valToPos(value, scale, true)];
    // The range of each run of samples without a gap is one shape: its upper edge, and back along the lower one.
    let upper = [], lower = [];
    const close = () => {
      [...upper, ...lower.reverse()].forEach((point, i) => range[i ? "lineTo" : "moveTo"](...point));
      if (upper.length) range.closePath();
      [upper, lower] = [[], []];
    };
    // Samples that are farther apart than the others share no mean: it would be one of a long time, with all its range.
    const duration = (times[last] - times[first]) * size / (last - first);
    for (let start = first, end; start <= last; start = end) {
      for (end = start + 1; end <= last && end < start + size && times[end] < times[start] + duration;) end++;
      const samples = Array.from(values.slice(start, end)).filter(value => value != null);
      if (!samples.length) { close(); continue; }
      const time = (times[start] + times[end - 1]) / 2;
      mean[upper.length ? "lineTo" : "moveTo"](...place(time, samples.reduce((sum, value) => sum + value, 0) / samples.length));
      upper.push(place(time, Math.max(...samples)));
      lower.push(place(time, Math.min(...samples)));
    }
    close();
    return { stroke: mean, fill: range, clip: null, band: null, gaps: null, flags: 0 };
  };

  // On paper, which may have no colours, the lines of a plot have dashes of their own: lengths of dashes and gaps in pixels,
  // by the number of the line. A line that is dashed on the screen stays so, a setpoint gives way to what follows it, and no
  // other line of the plot has the dashes of either.
  const DASHES = [7, 5], PAPER_DASHES = [[], DASHES, [1.5, 2.5], [9, 3, 1.5, 3], [14, 4], [9, 3, 1.5, 3, 1.5, 3], [3, 3, 1.5, 3], [20, 3]];
  const dashesOnPaper = (line, lines) => {
    const isSecondary = other => other.kind === "dashes" || other.name === "setpoint";
    if (isSecondary(line)) return DASHES;
    const free = PAPER_DASHES.filter(dashes => dashes !== DASHES || !lines.some(isSecondary));
    return free[lines.filter(other => other.kind === "line" && !isSecondary(other)).indexOf(line) % free.length];
  };
  // The dashes as the background of the line's mark in the legend, which is less than 48 pixels wide. Each dash is a layer:
  // Chromium's viewer of PDF, in which sheets are looked at before they are printed, leaves out gradients with gaps.
  const dashedBackground = (dashes, colour) => {
    const layers = [];
    for (let i = 0, start = 0; dashes.length && start < 48; i += 1) {
      const length = dashes[i % dashes.length];
      if (i % 2 === 0) layers.push(`linear-gradient(${colour}, ${colour}) ${start}px 0 / ${length}px 100% no-repeat`);
      start += length;
    }
    return layers.join(", ") || colour;
  };
  const isDashedOnPaper = (line, lines) => lines.length > 1 && (line.kind === "line" || line.kind === "dashes");

  // Where lines are equal each is seen: what was measured is wide, and dashes are wider than the solid line below them. Below
  // a bold line, what was asked for and predicted is thin.
  const WIDTHS = { wide: 4.5, bold: 2.3, dashes: 1.9 }, USUAL_WIDTH = 1.3, WIDTH_BELOW_BOLD = 1.1;
  const widthOf = (line, lines) => line.kind !== "bold" && lines.some(other => other.kind === "bold") ? WIDTH_BELOW_BOLD : WIDTHS[line.kind] ?? USUAL_WIDTH;
  const series = (line, lines) => {
    // Where lines lie over each other, each shines through.
    const isOneOfMany = lines.length > 3 && line.kind === "line";
    const drawn = { label: line.name, stroke: line.colour + (isOneOfMany ? "c0" : ""), width: widthOf(line, lines), scale: line.right ? "beside" : "y", points: { show: false } };
    if (isOneOfMany) Object.assign(drawn, { paths: meanAndRange, fill: () => line.colour + (root.classList.contains("printing") ? "14" : "30") });
    if (line.kind === "dashes") drawn.dash = DASHES;
    if (isDots(line) || line.kind === "stems") drawn.paths = () => null;
    return drawn;
  };

  // The least span of a vertical axis over the flight, by its unit: what changes by less, such as the last digit of a
  // logged value, does not fill a plot. A choice, by what pilots look for in motors, loads, voltages, angles and heights.
  const LEAST_SPANS = { "%": 40, V: 0.2, "°": 1, "°C": 2, kB: 1, µs: 20, m: 2 };
  // The least size of a value that is not 0, and the least change of one in relation to it: less is rounding.
  const LEAST_SIZE = 1e-12, LEAST_SHARE = 1e-6;
  const scale = (axis, padding, leastSpan = 0) => ({
    time: false, distr: axis.log ? 3 : 1,
    range: (_, min, max) => {
      const [low, high] = axis.ends || [null, null];
      if (min == null) return [low ?? (axis.log ? 1 : 0), high ?? (axis.log ? 10 : 1)];
      if (!padding) return [Math.max(min, low ?? min), Math.min(max, high ?? max)];
      // Of a logarithmic axis there is more than one number to read.
      const wide = axis.log ? Math.max(1, 2 / Math.sqrt(max / min)) : 1;
      if (axis.log) return [low ?? min / wide, high ?? max * 1.3 * wide];
      // The span grows in both directions, but not below 0 where nothing is negative.
      const lack = leastSpan - (max - min), isPositive = min >= 0;
      if (lack > 0) {
        // Shares of a whole end at 100 %.
        const top = unitOf(axis) === "%" && max <= 100 ? 100 - leastSpan : Infinity;
        const start = isPositive ? Math.max(0, Math.min(min - lack / 2, top)) : min - lack / 2;
        [min, max] = [start, start + leastSpan];
      }
      // What is 0 but for the rounding of a computer has the axis of 0.
      const size = Math.max(Math.abs(min), Math.abs(max));
      if (size < LEAST_SIZE) return [low ?? 0, high ?? 1];
      // What stays the same has an axis of a twentieth around it, on which its next change is seen.
      if (max - min < size * LEAST_SHARE) [min, max] = [min - size / 20, max + size / 20];
      const [from, to] = uPlot.rangeNum(min, max, 0.06, false);
      return [low ?? (min < 0 ? from : Math.max(from, 0)), high ?? to];
    },
  });

  // Where single peaks, such as those of an impact, would leave a line less than a fifth of the height of its plot over the
  // flight, the plot ends a quarter beyond the line, and beside its title stands how far the peaks go. On a screen a click
  // there shows them. The first plots over the flight show all there: a short loss of attitude is no mere peak. So do those
  // of a session that goes on.
  const PEAK_RATIO = 5, PEAK_SHARE = 0.02, BEYOND_LINE = 0.25;
  const mayBeCut = (figure, data) => isOverFlight(data) && data.lines.length && !data.picture
    && (root.classList.contains("printing") || !figure.closest("#flight") && !document.querySelector("main[data-level]"));
  // The vertical range without peaks, and the ends of all values, of what is shown; null where no peak is cut.
  const rangeWithoutPeaks = (data, [min, max]) => {
    const isShown = data.columns.map(x => x >= min && x <= max);
    const values = data.lines.flatMap(line => line.right ? [] : [...line.y].filter((value, i) => value != null && isShown[i])).sort((one, other) => one - other);
    if (!values.length || data.y.log || data.y.ends) return null;
    const at = share => values[Math.round(share * (values.length - 1))], low = at(PEAK_SHARE), high = at(1 - PEAK_SHARE), size = high - low;
    if (!size || values.at(-1) - values[0] <= PEAK_RATIO * size) return null;
    return { range: [low - BEYOND_LINE * size, high + BEYOND_LINE * size], ends: [values[0], values.at(-1)] };
  };
  // Writes beside the title of a chart whose axis is limited which lines leave it, and how far.
  const nameLinesOutside = (figure, data) => {
    const [low, high] = data.y.ends ?? [];
    // Over all frequencies a gain or phase always leaves the part around the crossover.
    if (low == null || high == null || data.picture || data.x.log) return;
    const words = [];
    for (const line of data.lines) {
      const values = line.right ? [] : [...line.y].filter(value => value != null && (value < low || value > high));
      if (!values.length) continue;
      const farthest = values.reduce((one, other) => Math.max(low - one, one - high) > Math.max(low - other, other - high) ? one : other);
      words.push(`${line.name} ${farthest < low ? "down" : "up"} to ${digits(Math.round(farthest))}`);
    }
    if (words.length) figure.querySelector("header > h3").after(Object.assign(element("span", "cut"), { textContent: `off the scale: ${words.join(", ")}` }));
  };
  // Decides for a span of time whether a chart is cut, and writes it beside its title. Its next scale has that range.
  const cutPeaks = (figure, data, span) => {
    const isForPaper = root.classList.contains("printing"), cut = mayBeCut(figure, data) ? rangeWithoutPeaks(data, span) : null;
    const isCut = cut && (isForPaper || !data.hasPeaks);
    data.cut = isCut ? cut.range : null;
    figure.querySelector("header > .cut")?.remove();
    if (!cut) {
      nameLinesOutside(figure, data);
      return;
    }
    const farthest = cut.range[0] - cut.ends[0] > cut.ends[1] - cut.range[1] ? cut.ends[0] : cut.ends[1], ends = `${digits(Math.round(cut.ends[0]))} to ${digits(Math.round(cut.ends[1]))}`;
    const words = isForPaper ? `cut, peaks from ${ends}` : isCut ? `show peak ${digits(Math.round(farthest))}` : "cut peaks";
    const note = Object.assign(element(isForPaper ? "span" : "button", isForPaper ? "cut" : "cut plain"), { textContent: words });
    note.addEventListener("click", () => {
      data.hasPeaks = !data.hasPeaks;
      zoom(groups[data.group], ...span);
      figure.querySelector("header > .cut")?.focus();
    });
    figure.querySelector("header > h3").after(note);
  };

  // Whether names fit below the things that they name; otherwise only the first and the last one are written.
  const hasRoom = (chart, names) => Math.max(...names.map(name => name.length)) * 6.5 < chart.bbox.width / devicePixelRatio / names.length;

  // Pixels of a plot's padding above, which the numbers of events need.
  const above = data => hasNumbers(data) && data.lines.length ? 13 : data.x.names.length && data.marks.length ? MARKS_ABOVE + 2 : 6;
  // Each of the first plots over the flight has times of its own: a sheet or a telephone may end between them. So have
  // plots over frequency, whose numbers are read off each.
  const hasTimes = figure => figure.closest("#flight .plots") != null;
  const hasNumbersBelow = (figure, data) => data.x.log || hasTimes(figure);
  const height = (figure, data) => {
    const isFlat = figure.dataset.flat != null, isBare = figure.dataset.bare != null, isForPaper = root.classList.contains("printing");
    if (!data.lines.length) return isForPaper ? 20 : 26;
    // Many lines in one plot, such as those of all motors, are told apart only where it is high.
    const isCrowded = data.lines.length > 3, isWide = figure.clientWidth > 500;
    // On paper two of the first plots stand beside each other, and plots below each other share an axis on one sheet.
    const isFirst = hasTimes(figure), heightOnPaper = isFirst || isCrowded || isBare ? 84 : isFlat || isWide ? 60 : 96;
    const plotHeight = isForPaper ? heightOnPaper : (isCrowded || !isFlat ? 154 : 118);
    const axisHeight = isBare ? (hasNumbersBelow(figure, data) ? (isForPaper ? 16 : 18) : 0) : isForPaper ? 26 : 34;
    return above(data) + plotHeight + axisHeight;
  };

  // What a figure shows: its data with the values unpacked, and the columns, series and bands that uPlot has of them.
  const contentOf = figure => {
    const data = JSON.parse(figure.querySelector("script").textContent), drawn = [{}], bands = [];
    data.columns = unpack(data.at, data.x.log) || data.x.ends;
    const columns = [data.columns];
    if (data.lines[0]?.heat) {
      data.picture = picture(data.lines[0]);
      data.y.ends = data.lines[0].ends;
    } else for (const line of data.lines) {
      for (const part of ["y", "low", "high"]) line[part] = unpack(line[part], line.right ? false : data.y.log);
      if (line.low) for (const part of ["high", "low"]) {
        columns.push(line[part]);
        drawn.push({ stroke: "transparent", scale: line.right ? "beside" : "y", points: { show: false }, paths: isDots(line) ? () => null : undefined });
      }
      if (line.low && !isDots(line)) bands.push({ series: [drawn.length - 2, drawn.length - 1], fill: line.colour + "38" });
      line.y = withoutSamples(line.y);
      columns.push(line.y);
      line.series = line.low ? [drawn.length - 2, drawn.length - 1, drawn.length] : [drawn.length];
      drawn.push(series(line, data.lines));
    }
    return { data, columns, drawn, bands };
  };
  // The span of the common axis that the data of a chart have.
  const wholeOf = data => data.x.ends || [data.columns[0], data.columns.at(-1)];

  const withCut = (data, options) => ({ ...options, range: (...limits) => data.cut ?? options.range(...limits) });
  const draw = figure => {
    const { data, columns, drawn, bands } = contentOf(figure), group = data.group && (groups[data.group] ??= { charts: [], formerSpans: [] });
    const strip = !data.lines.length, bare = figure.dataset.bare != null || strip;
    const grid = { stroke: () => colour("--line"), width: 1 }, noLabels = (_, splits) => splits.map(() => "");
    // Room of a label below a plot: a narrow plot has six all the same, where they are short enough, so that three or more
    // ticks are round numbers.
    const spaceBelow = (_, axisNumber, min, max, pixels) => {
      const isForPaper = root.classList.contains("printing"), letters = digits(max, max - min).length + (max - min < 6 ? 2 : 0);
      return Math.max(isForPaper ? 5.5 * letters + 6 : 7 * letters + 10, Math.min(50, pixels / 6));
    };
    const space = () => root.classList.contains("printing") ? 10 : figure.dataset.flat != null ? 16 : 30;
    const width = (_, texts) => Math.max(50, ...(texts ?? []).filter(text => text?.length > 5).map(text => 14 + 7.2 * text.length));
    const base = { stroke: () => colour("--ink"), font: font(), grid, ticks: grid, labelFont: font(), labelSize: 16, labelGap: 0 };
    const shown = axis => axis.ticks ? { splits: () => axis.ticks.map(([value]) => value), values: () => axis.ticks.map(([, name]) => name) } : axis.names.length
      ? { splits: () => axis.names.map((_, i) => i), values: (chart, splits) => splits.map(i => hasRoom(chart, axis.names) || i === 0 || i === axis.names.length - 1 ? axis.names[i] : "") }
      : axis.log ? { splits: logarithmicSplits, filter: labelledSplits, grid: { ...grid, filter: labelledSplits }, ticks: { ...grid, filter: labelledSplits }, values: (_, splits) => splits.map(value => value == null ? null : digits(value)) } : { values: (_, splits, axis, space, step) => splits.map(value => digits(value, step)) };
    // The last name is centred on its tick, so that half of it needs room to the right.
    const rightPadding = data.beside ? 0 : edge + 2 * (data.x.names.at(-1)?.length ?? 0);
    const options = {
      width: figure.clientWidth, height: height(figure, data), series: drawn, bands,
      padding: [strip ? 2 : above(data), rightPadding, bare ? (strip ? 0 : 6) : 0, 0],
      scales: { x: scale(data.x, false), y: withCut(data, scale(data.y, true, isOverFlight(data) ? LEAST_SPANS[unitOf(data.y)] : 0)), ...(data.beside ? { beside: scale(data.beside, true) } : {}) },
      axes: [
        { ...base, ...shown(data.x), ...(data.x.log ? {} : { space: spaceBelow }), size: () => bare ? (!strip && hasNumbersBelow(figure, data) ? 18 : 0) : root.classList.contains("printing") ? 32 : 40, show: !strip, label: bare ? undefined : data.x.label, ...(bare ? { ticks: { ...grid, size: 3 }, gap: 2, values: (...splits) => (hasNumbersBelow(figure, data) ? shown(data.x).values : noLabels)(...splits) } : {}) },
        { ...base, ...(strip ? { values: noLabels, grid: { show: false }, ticks: { show: false } } : shown(data.y)), size: width, space },
        ...(data.beside ? [{ ...base, ...shown(data.beside), scale: "beside", side: 1, size: 52, space, grid: { show: false }, label: data.beside.label }] : []),
      ],
      legend: { show: false },
      cursor: { y: !!data.picture, points: { size: 6 }, ...(data.group ? { sync: { key: data.group } } : {}), drag: { x: !!data.group, y: false } },
      hooks: {
        drawClear: [chart => drawBackground(data, chart)], draw: [chart => drawForeground(data, chart)],
        setCursor: [chart => showValues(figure, data, chart)],
        setSelect: [chart => group && chart.select.width && rememberSpan(group)],
        setScale: [(chart, key) => key === "x" && group && group.charts.includes(chart) && zoom(group, chart.scales.x.min, chart.scales.x.max)],
      },
    };
    if (data.x.names.length) {
      options.scales.x.range = () => [-0.5, data.x.names.length - 0.5];
    }
    const chart = new uPlot(options, columns, figure.querySelector(".plot"));
    chart.data_ = data;
    addLegend(figure, data, chart);
    followTouch(chart, group);
    if (data.x.addresses) {
      // A finger only moves the cursor.
      const addressAtCursor = () => chart.cursor.idx == null ? "" : data.x.addresses[Math.round(data.columns[chart.cursor.idx])];
      chart.over.addEventListener("click", event => { if (event.pointerType !== "touch" && addressAtCursor()) location.href = addressAtCursor(); });
      chart.over.style.cursor = "pointer";
    }
    if (group) {
      if (strip) group.modes = data.spans;
      group.charts.push(chart);
      // The chart's own scale is set later. The plots of a lost flight open around the loss.
      group.whole ??= wholeOf(data);
      const span = data.group === "flight" && figure.closest("[data-opens-at]")?.dataset.opensAt;
      if (span) group.span ??= span.split(" ").map(Number);
      const [min, max] = group.span ?? group.whole;
      cutPeaks(figure, data, [min, max]);
      chart.setScale("x", { min, max });
      figure.addEventListener("keydown", event => {
        const [first, last] = group.whole, { min, max } = chart.scales.x, size = max - min;
        if (event.key === "Backspace" && group.formerSpans.length) {
          event.preventDefault();
          zoom(group, ...group.formerSpans.pop());
          return;
        }
        if (event.shiftKey && event.key.startsWith("Arrow")) {
          const now = chart.cursor.idx == null ? (min + max) / 2 : chart.posToVal(chart.cursor.left, "x");
          event.preventDefault();
          setCursor(group, Math.max(min, Math.min(now + (event.key === "ArrowRight" ? size : -size) / 100, max)));
          return;
        }
        const to = { ArrowLeft: [min - size / 4, max - size / 4], ArrowRight: [min + size / 4, max + size / 4],
          "+": [min + size / 4, max - size / 4], "-": [min - size / 2, max + size / 2], Escape: [first, last] }[event.key];
        if (!to) return;
        event.preventDefault();
        zoom(group, Math.max(first, Math.min(to[0], last - 0.1)), Math.min(last, Math.max(to[1], first + 0.1)));
      });
      chart.root.addEventListener("dblclick", () => rememberSpan(group), true); // before uPlot shows all of this chart
      chart.over.addEventListener("dblclick", () => zoom(group, ...group.whole));
      followDragWithShift(figure, chart, group);
    }
    return chart;
  };

  // The legend of a chart: the cursor's place, and for each line its name and its value there. A name hides its line.
  const markOf = (line, lines) => {
    const ink = line.kind === "dashes" ? dashedBackground(DASHES, line.colour) : line.colour;
    const mark = Object.assign(element("i"), { className: line.kind, style: `background: ${ink}; border-color: ${line.colour}` });
    if (isDots(line)) mark.className = `dot${line.kind === "squares" ? " square" : ""}${isRing(line, lines) ? " ring" : ""}`;
    if (isDashedOnPaper(line, lines)) mark.style.setProperty("--on-paper", dashedBackground(dashesOnPaper(line, lines), line.colour));
    return mark;
  };
  const addLegend = (figure, data, chart) => {
    const header = figure.querySelector("header");
    if (!header) return;
    const legend = element("div", "legend"), at = element("span", "at"), named = data.lines.length > 1;
    legend.append(at);
    // A word that all names begin with, such as "motor", stands once.
    const commonWord = /^\S+ (?=\S)/.exec(named ? data.lines[0].name : "")?.[0], isCommon = commonWord && data.lines.every(line => line.name.startsWith(commonWord));
    const letters = data.lines.map(line => isCommon ? line.name.slice(commonWord.length) : line.name).join("").length;
    if (letters <= 24) legend.classList.add("short");
    if (named) legend.classList.add("named");
    if (isCommon && letters <= 2 * data.lines.length) legend.classList.add("numbered");
    if (isCommon) legend.append(Object.assign(element("span", "common"), { textContent: commonWord.trim() }));
    const entries = [];
    data.values = data.picture ? [] : data.lines.map(line => {
      const hides = named && !isDots(line) && line.kind !== "stems";
      const entry = element(hides ? "button" : "span"), value = element("b");
      if (named) entry.append(markOf(line, data.lines), Object.assign(element("span"), { textContent: isCommon ? line.name.slice(commonWord.length) : line.name }), " ");
      if (isCommon) entry.setAttribute("aria-label", line.name);
      entry.append(value);
      entries.push(entry);
      if (!hides) return value;
      Object.assign(entry, { type: "button", title: "Hide or show" });
      entry.addEventListener("click", () => {
        const show = !chart.series[line.series.at(-1)].show;
        for (const number of line.series) chart.setSeries(number, { show });
        entry.setAttribute("aria-pressed", show);
      });
      return value;
    });
    // A bold line is drawn last, over the others, and read first.
    legend.append(...data.lines.some(({ kind }) => kind === "bold") ? entries.reverse() : entries);
    data.at = at;
    if (data.picture) {
      // The colours of a spectrogram, from the least power to the highest, to which the values under the cursor relate.
      const colours = element("span", "colours"), scale = element("i");
      colours.append(`${digits(Math.round(-data.lines[0].range))} `, scale, "0 dB");
      legend.append(colours);
    }
    if (data.x.names.length) {
      // Where things are counted, the words on a line stand beside the title, since in the plot they would lie over lines;
      // the thing under the cursor has their place.
      const remarked = data.lines.find(line => line.remark), remark = element("span", "remark");
      if (remarked) Object.assign(remark, { textContent: remarked.remark, style: `color: ${remarked.colour}` });
      header.append(remark, at);
      legend.classList.add("below");
    }
    header.append(legend);
  };
  const element = (tag, name = "") => Object.assign(document.createElement(tag), { className: name });

  // The unit of an axis, which its label has in brackets or after a comma: "s" of "time since boot (s)", "%" of "Motors, %".
  const unitOf = axis => /\(([^()]*)\)$/.exec(axis.label)?.[1] ?? /, ([^,]*)$/.exec(axis.label)?.[1] ?? "";
  // The number with that unit: "12.3 s".
  const onAxis = (value, axis) => axis.names.length ? axis.names[Math.round(value)] ?? "" : `${digits(Number(value.toPrecision(4)))} ${unitOf(axis)}`.trim();
  // A value under the cursor as text, to about the five-hundredth part of the axis that is shown: a pixel shows no more.
  const valueText = (value, scale) => {
    if (value == null) return "";
    const rounded = Number(value.toPrecision(4)), decimals = Math.ceil(-Math.log10((scale.max - scale.min) / 500));
    return digits(scale.distr === 3 ? rounded : Number(rounded.toFixed(Math.max(0, Math.min(decimals, 20)))));
  };
  // A direction in degrees as its nearest point of the compass and a number from 0 to 359, "WSW (254°)".
  const COMPASS_POINTS = ["N", "NNE", "NE", "ENE", "E", "ESE", "SE", "SSE", "S", "SSW", "SW", "WSW", "W", "WNW", "NW", "NNW"];
  const wholeDegrees = direction => (Math.round(direction) % 360 + 360) % 360;
  const compassText = direction => `${COMPASS_POINTS[Math.round(wholeDegrees(direction) / 22.5) % 16]} (${wholeDegrees(direction)}°)`;
  // A line's value under the cursor. Over the flight, the one line of a chart with a band has that and the unit too, "4.1
  // (3.5 to 4.9) m/s"; where only the band is known, that. An axis with named ticks is one of directions.
  const readoutOf = (line, index, data, chart) => {
    const scale = chart.scales[line.right ? "beside" : "y"], value = line.y[index], low = line.low?.[index], high = line.high?.[index];
    if (data.y.ticks && value != null) return low == null ? compassText(value) : `${compassText(value)} ± ${Math.round(Math.max(high - value, value - low))}°`;
    const isOnlyBand = data.group === "flight" && data.lines.filter(other => other.low).length === 1 && low != null && high != null;
    if (!isOnlyBand) return valueText(value, scale);
    const interval = `${valueText(low, scale)} to ${valueText(high, scale)}`;
    return `${value == null ? interval : `${valueText(value, scale)} (${interval})`} ${unitOf(data.y)}`.trim();
  };
  // Pixels between the cursor and a value under it: a step of a line with few points, at least some.
  const nearby = (count, width) => Math.max(20, width / count);
  const showValues = (figure, data, chart) => {
    const { left, top, idx } = chart.cursor, inside = left >= 0 && idx != null, x = inside ? chart.posToVal(left, "x") : null;
    if (data.group === "flight") root.dispatchEvent(new CustomEvent("cursor", { detail: x }));
    if (!data.at) return;
    data.at.parentElement.classList.toggle("read", inside);
    if (!data.picture) {
      // Of a chart that begins later or ends earlier, the nearest value is none of the cursor's.
      const isNear = inside && Math.abs(chart.valToPos(data.columns[idx], "x") - left) <= nearby(data.columns.length, chart.over.clientWidth);
      data.at.textContent = isNear ? onAxis(data.columns[idx], data.x) : "";
      data.lines.forEach((line, i) => data.values[i].textContent = isNear ? readoutOf(line, idx, data, chart) : "");
      return;
    }
    const { heat, rows, ends, range } = data.lines[0], hovered = inside && (chart.touched || chart.over.matches(":hover"));
    data.at.textContent = inside ? onAxis(x, data.x) : "";
    if (!hovered) return;
    const [first, last] = data.columns, y = chart.posToVal(top, "y"), bytes = data.bytes ??= Uint8Array.from(atob(heat), c => c.charCodeAt(0)), count = bytes.length / rows;
    const row = Math.round((x - first) / (last - first) * (rows - 1)), column = Math.round((y - ends[0]) / (ends[1] - ends[0]) * (count - 1));
    if (row < 0 || row >= rows || column < 0 || column >= count) return;
    data.at.textContent += `, ${onAxis(y, data.y)}: ${digits(Math.round(range * (bytes[row * count + column] / 255 - 1)))} dB`;
  };

  // Sets the cursor of all charts of a group at a place of their common axis.
  const setCursor = (group, x) => {
    for (const chart of group.charts) chart.setCursor({ left: chart.valToPos(x, "x"), top: 1 }, true, false);
  };

  // Keeps the span that a group shows, before a mouse changes it. Charts of a group report one drag each.
  const rememberSpan = group => {
    const [min, max] = group.span ?? group.whole, former = group.formerSpans.at(-1);
    if (former?.[0] !== min || former?.[1] !== max) group.formerSpans.push([min, max]);
  };

  // Dragging with Shift moves the charts of a group through the flight, with the span that they show.
  const followDragWithShift = (figure, chart, group) => chart.root.addEventListener("mousedown", event => {
    if (!event.shiftKey || event.button !== 0) return;
    event.stopPropagation(); // uPlot would zoom
    event.preventDefault(); // a browser would select text
    figure.focus({ preventScroll: true });
    const { min, max } = chart.scales.x, size = max - min, secondsPerPixel = size / chart.over.clientWidth;
    const [first, last] = group.whole;
    const move = ({ clientX }) => {
      const start = Math.max(first, Math.min(min + (event.clientX - clientX) * secondsPerPixel, last - size));
      zoom(group, start, start + size);
    };
    document.addEventListener("mousemove", move);
    document.addEventListener("mouseup", () => document.removeEventListener("mousemove", move), { once: true });
  }, true);

  // Fingers on a chart. One moves the cursor of its group; two zoom and shift the group, so that the place under each
  // stays under it; a double tap shows the whole again. Up and down the page scrolls, which ends what a finger does.
  const DOUBLE_TAP_MS = 350, TAP_PIXELS = 20, LEAST_SPAN = 0.1;
  const followTouch = (chart, group) => {
    const { over } = chart, fingers = new Map();
    let held = null, moved = false, lastTap = null;
    over.style.touchAction = "pan-y";
    const placeOf = event => ({ left: event.clientX - over.getBoundingClientRect().left, top: event.clientY - over.getBoundingClientRect().top });
    const moveCursor = ({ left, top }) => {
      chart.touched = true; // a finger hovers over nothing
      const x = chart.posToVal(Math.max(0, Math.min(left, over.clientWidth)), "x");
      if (group) setCursor(group, x);
      if (!group || chart.data_.picture) chart.setCursor({ left, top }, true, false);
    };
    const pinch = () => {
      const [one, other] = [...fingers.values()].map(({ left }) => left), distance = other - one;
      const apart = Math.abs(distance) < TAP_PIXELS ? TAP_PIXELS * (Math.sign(distance) || 1) : distance;
      const [first, last] = group.whole, slope = (held[1] - held[0]) / apart;
      const span = Math.max(LEAST_SPAN, Math.min(slope * over.clientWidth, last - first));
      const min = Math.max(first, Math.min(held[0] - slope * one, last - span));
      if (slope > 0) zoom(group, min, min + span);
    };
    over.addEventListener("pointerdown", event => {
      if (event.pointerType !== "touch") return;
      fingers.set(event.pointerId, placeOf(event));
      moved = fingers.size > 1;
      if (fingers.size === 1) moveCursor(placeOf(event));
      held = fingers.size === 2 ? [...fingers.values()].map(({ left }) => chart.posToVal(left, "x")) : null;
    });
    over.addEventListener("pointermove", event => {
      const start = fingers.get(event.pointerId), place = placeOf(event);
      if (!start) return;
      if (Math.hypot(place.left - start.left, place.top - start.top) > 2) moved = true;
      fingers.set(event.pointerId, place);
      if (fingers.size === 1) moveCursor(place); else if (held && group) pinch();
    });
    for (const kind of ["pointerup", "pointercancel"]) over.addEventListener(kind, event => {
      if (!fingers.delete(event.pointerId)) return;
      held = null;
      if (kind === "pointercancel" || moved || fingers.size) return;
      const tap = { time: event.timeStamp, ...placeOf(event) };
      const isDouble = lastTap && tap.time - lastTap.time < DOUBLE_TAP_MS && Math.hypot(tap.left - lastTap.left, tap.top - lastTap.top) < TAP_PIXELS;
      lastTap = isDouble ? null : tap;
      if (isDouble && group) zoom(group, ...group.whole);
    });
    // A browser makes a tap a mouse's click too, which would move one chart's cursor away from the others'.
    over.addEventListener("touchend", event => event.cancelable && event.preventDefault(), { passive: false });
  };

  const charts = new Map(), figures = [...document.querySelectorAll("figure.chart")];
  const fit = (figure, always = false) => {
    if (!figure.clientWidth) return;
    if (!charts.has(figure)) return charts.set(figure, draw(figure));
    const chart = charts.get(figure);
    if (always || chart.width !== figure.clientWidth) chart.setSize({ width: figure.clientWidth, height: height(figure, chart.data_) });
  };
  const repaint = () => {
    for (const figure of figures) fit(figure); // a page that is printed at once has not been drawn yet
    for (const group of Object.values(groups)) if (group.charts.length) zoom(group, ...(group.span ?? group.whole));
    for (const figure of figures) {
      const chart = charts.get(figure);
      if (!chart) continue; // it is folded away
      const { lines } = chart.data_, isForPaper = root.classList.contains("printing");
      for (const line of lines.filter(line => isDashedOnPaper(line, lines)))
        chart.series[line.series.at(-1)].dash = isForPaper ? dashesOnPaper(line, lines).map(length => length * devicePixelRatio) : line.kind === "dashes" ? DASHES : undefined;
      for (const axis of chart.axes) for (const one of [axis.font, axis.labelFont]) one[0] = font().replace(/\d+/, size => size * devicePixelRatio);
      fit(figure, true);
      chart.redraw(false, true);
    }
    alignHeaders();
  };
  // Charts beside each other begin at one height, though some legends take two lines: the headers that begin at one height
  // are as high as the highest of them, from the uppermost row of charts on, since each row moves those below it.
  const alignHeaders = () => {
    const topOf = header => header.getBoundingClientRect().top;
    for (const group of document.querySelectorAll(".charts")) {
      let headers = [...group.querySelectorAll("figure.chart > header")].filter(header => header.offsetHeight);
      for (const header of headers) header.style.minHeight = "";
      while (headers.length) {
        const top = Math.min(...headers.map(topOf)), row = headers.filter(header => topOf(header) < top + 1);
        headers = headers.filter(header => !row.includes(header));
        const most = Math.max(...row.map(header => header.offsetHeight));
        // The highest one gets that height too, since on wider paper its legend may take one line.
        if (row.some(header => header.offsetHeight < most)) for (const header of row) header.style.minHeight = `${most}px`;
      }
    }
  };
  // What decides how uPlot draws a figure besides the values of its lines.
  const formOf = (figure, data) => JSON.stringify([
    { ...figure.dataset }, data.title, data.group, data.x.label, data.x.names.length, data.y.label, data.y.log, data.beside?.label, hasNumbers(data),
    data.lines.map(({ name, kind, colour, right, low }) => [name, kind, colour, right, !!low]),
  ]);
  const forget = figure => {
    const chart = charts.get(figure), groupOf = chart?.data_.group && groups[chart.data_.group];
    if (groupOf) groupOf.charts.splice(groupOf.charts.indexOf(chart), 1);
    chart?.destroy();
    charts.delete(figure);
    figures.splice(figures.indexOf(figure), 1);
    observer.unobserve(figure);
  };
  const observe = figure => {
    figures.push(figure);
    observer.observe(figure);
  };
  // Gives a figure what a newer one of the same place shows. Only one that has other lines or axes is drawn anew.
  const renew = (figure, newer) => {
    const chart = charts.get(figure), script = figure.querySelector("script"), text = newer.querySelector("script").textContent;
    const { data, columns } = contentOf(newer), isSame = script.textContent === text;
    if (!chart || formOf(figure, chart.data_) !== formOf(newer, data)) {
      forget(figure);
      figure.replaceWith(newer);
      observe(newer);
    } else if (!isSame) {
      script.textContent = text;
      figure.setAttribute("aria-label", newer.getAttribute("aria-label"));
      // The chart's functions hold these axes, and its legend is at "at".
      const { x, y, beside } = chart.data_, { at } = chart.data_;
      Object.assign(chart.data_, data, { at, x: Object.assign(x, data.x), y: Object.assign(y, data.y), beside: beside && Object.assign(beside, data.beside) });
      if (data.group && !data.lines.length) groups[data.group].modes = data.spans;
      chart.setData(columns, false);
    }
  };
  // After charts were renewed: those that showed all show all, those zoomed to the end follow it, others stay. Where no
  // chart is left, as between two flights, the next ones begin with their own span.
  const follow = group => {
    if (!group.charts.length) {
      group.whole = group.span = undefined;
      group.formerSpans = [];
      return;
    }
    const [first, last] = group.whole, [min, max] = group.span ?? group.whole, wholes = group.charts.map(({ data_ }) => wholeOf(data_));
    const newest = [Math.min(...wholes.map(([start]) => start)), Math.max(...wholes.map(([, end]) => end))], later = newest[1] - last;
    group.whole = newest;
    const isOutside = max <= newest[0] || min >= newest[1];
    if (isOutside || min <= first && max >= last) zoom(group, ...newest); else if (max >= last) zoom(group, min + later, max + later); else zoom(group, min, max);
  };
  // The time under the cursor of a group's charts; null where there is none, or the mouse holds it at its place.
  const cursorOf = group => {
    const chart = group.charts.find(({ cursor }) => cursor.idx != null && cursor.left >= 0);
    return !chart || group.charts.some(({ over }) => over.matches(":hover")) ? null : chart.posToVal(chart.cursor.left, "x");
  };
  root.classList.add("plotted");
  let isFirst = true;
  const observer = new ResizeObserver(entries => requestAnimationFrame(() => {
    entries.forEach(entry => fit(entry.target));
    alignHeaders();
    if (isFirst) root.dispatchEvent(new Event("drawn"));
    isFirst = false;
  }));
  for (const figure of figures) observer.observe(figure);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach(chart => chart.redraw(false, true)));
  // What is printed beside the charts is opened first, since their marks are those of the printed events. A browser calls
  // the listeners of a window in the order in which they were added, whether they capture or not.
  addEventListener("beforeprint", () => {
    root.dispatchEvent(new Event("openforpaper"));
    layOut(true);
  });
  addEventListener("afterprint", () => layOut(false));
  // The times of all lines, and the values of each at these: false where it has no sample, which is no gap.
  const joined = lines => {
    const [times, ...values] = lines.length === 1 ? [lines[0].times, lines[0].values] : uPlot.join(lines.map(line => [line.times, line.values]));
    return { times, values: values.map(line => Array.from(line, value => value === undefined ? false : value)) };
  };
  // Adds a chart of the flight below the others: the figure, which "replace" gives other points and "remove" takes away.
  const addLines = (column, label, lines) => {
    const { times, values } = joined(lines);
    // Events and shaded times are those of another plot; a strip, such as that of the modes, has none of them.
    const { x, marks, spans, lines: linesOfOther } = (groups.flight.charts.find(chart => chart.data_.lines.length) ?? groups.flight.charts[0]).data_;
    const isStrip = !linesOfOther.length;
    const axis = { label, log: false, ends: null, names: [] }, drawn = lines.map(({ name, colour }, i) => ({ name, colour, kind: "line", y: values[i] }));
    const data = { title: label, x, y: axis, at: times, lines: drawn, levels: [], marks, spans: isStrip ? [] : spans, group: "flight" };
    const figure = element("figure", "chart"), header = element("header");
    Object.assign(figure, { tabIndex: 0 }).setAttribute("data-flat", "");
    figure.setAttribute("role", "img");
    figure.setAttribute("aria-label", label);
    header.append(Object.assign(element("h3"), { textContent: label }));
    figure.append(header, element("div", "plot"), Object.assign(element("script"), { type: "application/json", textContent: JSON.stringify(data) }));
    column.append(figure);
    observe(figure);
    return {
      figure, header,
      replace: newLines => {
        const chart = charts.get(figure);
        if (!chart) return;
        const { times, values } = joined(newLines), columns = values.map(withoutSamples), { min, max } = chart.scales.x;
        chart.data_.columns = times;
        chart.data_.lines.forEach((line, i) => { line.y = columns[i]; });
        chart.batch(() => { chart.setData([times, ...columns], false); chart.setScale("x", { min, max }); });
      },
      remove: () => {
        forget(figure);
        figure.remove();
      },
    };
  };
  root.charts = { addLines, renew, observe, forget, follow, cursorOf, groups, zoom, setCursor, unpack, digits, compassText };
})();
