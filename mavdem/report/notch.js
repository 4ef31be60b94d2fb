// The notch filter of a page, whose settings its reader tries: spectrum, gain, phase and parameter files follow them.
// The equations are those of notch_response in mavdem/loops/filters.py, which names their sources; a test compares them.
(() => {
  const root = document.documentElement, form = document.querySelector("form.notch");
  if (!form) return;
  const model = JSON.parse(form.querySelector(":scope > script").textContent), { names } = model;
  const settings = { ...model.parameters };
  let on = model.wasOn;

  // Where the first harmonic is, in Hz: not at the parameter's value where it follows the throttle or is too wide.
  const leastCentre = () => Math.max(settings[names.centre], model.leastCentrePerWidth * settings[names.width]);
  const fundamental = () => model.isArduPilot ? leastCentre() * model.hoverRatio : settings[names.centre];

  // The notches in series: centre in Hz, damping 1/Q of the poles, and gain at the centre.
  const notches = () => {
    if (!on) return [];
    const centre = settings[names.centre], width = settings[names.width];
    if (!(centre > 0 && width > 0)) return [];
    if (!model.isArduPilot) {
      if (centre >= model.maxRatio * model.rate) return [];
      const alpha = Math.tan(Math.PI * Math.min(width / model.rate, model.maxRatio));
      return [{ centre, damping: 2 * alpha / Math.sin(2 * Math.PI * centre / model.rate), gain: 0 }];
    }
    const half = width / leastCentre() / 2;
    const damping = half * (2 - half) / (1 - half), gain = 10 ** (-settings[names.depth] / 20), all = [];
    if (!(settings[names.depth] > 0)) return [];
    for (let multiple = 1; multiple <= model.mostHarmonics; multiple++) {
      const place = multiple * fundamental();
      if (!(settings[names.harmonics] >> (multiple - 1) & 1) || place >= model.maxRatio * model.rate) continue;
      for (let source = 0; source < model.sources; source++) all.push({ centre: place, damping, gain });
    }
    return all;
  };

  // Gain and phase in degrees at a frequency in Hz. The phase of each notch is within a quarter turn, so that their sum
  // is the phase without jumps.
  const response = (all, frequency) => {
    let gain = 1, phase = 0;
    for (const notch of all) {
      const x = Math.tan(Math.PI * frequency / model.rate) / Math.tan(Math.PI * notch.centre / model.rate);
      const real = 1 - x * x, above = notch.gain * notch.damping * x, below = notch.damping * x;
      gain *= Math.hypot(real, above) / Math.hypot(real, below);
      // The quotient of two numbers with the same real part: its phase from their cross and dot product.
      phase += Math.atan2(real * (above - below), real * real + above * below);
    }
    return { gain, phase: 180 / Math.PI * phase };
  };

  const decibels = gain => 20 * Math.log10(Math.max(gain, model.minGain));
  const shown = (value, digits = 1) => value.toFixed(digits).replace(/^-(0(\.0+)?)$/, "$1").replace("-", "−");
  const before = response(notches(), model.crossover).phase;

  const drawCharts = all => {
    for (const chart of root.charts?.groups.notch?.charts ?? []) {
      const { columns, lines, title } = chart.data_, last = lines.at(-1), asked = lines.at(-2)?.y;
      const at = columns.map(frequency => response(all, frequency));
      if (title.startsWith("Gain")) last.y = at.map(one => decibels(one.gain));
      else if (title.startsWith("Phase")) last.y = at.map(one => one.phase);
      else last.y = at.map((one, i) => asked[i] == null ? null : Math.max(asked[i] * one.gain ** 2, 1e-12));
      const data = [...chart.data];
      data[last.series.at(-1)] = last.y;
      const { min, max } = chart.scales.x;
      chart.batch(() => { chart.setData(data, true); chart.setScale("x", { min, max }); });
    }
  };

  // The parameter files are those that were written with the page, with other values in their lines.
  const fileText = text => {
    const values = on ? settings : { ...settings, ...model.off };
    for (const [name, value] of Object.entries(values))
      text = text.replace(new RegExp(`((?:^|\\t)${name}[,\\t])[^\\t\\n]+`, "m"), `$1${Number(value.toPrecision(9))}`);
    return text;
  };

  const update = () => {
    for (const slider of form.querySelectorAll("input[type=range]")) {
      const text = `${Number(settings[slider.name].toPrecision(4))} ${slider.dataset.unit}`;
      slider.nextElementSibling.textContent = text;
      slider.setAttribute("aria-valuetext", text);
    }
    const all = notches(), { phase } = response(all, model.crossover), gain = decibels(response(all, model.peak).gain);
    const moved = all.length && Math.abs(fundamental() - settings[names.centre]) >= 0.5;
    const deepest = gain <= decibels(0) ? "at least " : "";
    form.querySelector(".effects").textContent = (moved ? `Its centre is at ${shown(fundamental(), 0)} Hz. ` : "") + `At the peak of ${shown(model.peak, 0)} Hz it takes ${deepest}${shown(-gain)} dB. `
      + `${model.place} ${shown(model.crossover)} Hz it costs ${shown(-phase)}° of phase`
      + (model.wasOn ? `; as logged, ${shown(-before)}°.` : ".");
    form.querySelectorAll("a.button").forEach((link, i) => {
      link.download = model.files[i].name;
      link.href = `data:text/plain;charset=utf-8,${encodeURIComponent(fileText(model.files[i].text))}`;
    });
    drawCharts(all);
  };

  form.addEventListener("input", ({ target }) => {
    if (target.type === "range") {
      settings[target.name] = target.valueAsNumber;
      // Who moves a slider wants to see what it does.
      form.elements.on.checked = on = true;
    } else if (target.name === "harmonic") {
      const bit = 1 << (target.value - 1), mask = settings[names.harmonics];
      settings[names.harmonics] = target.checked ? mask | bit : mask & ~bit;
      form.elements.on.checked = on = true;
    } else on = target.checked;
    update();
  });
  form.addEventListener("submit", event => event.preventDefault());
  update();
  root.notch = { response: frequency => response(notches(), frequency) };
})();
