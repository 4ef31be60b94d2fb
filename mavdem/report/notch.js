// The notch filters of a page, whose settings its reader tries: spectrum, gain, phase and parameter files follow them.
// The equations are those of notch_response in mavdem/loops/filters.py, which names their sources; a test compares them.
(() => {
  const root = document.documentElement, form = document.querySelector("form.notch");
  if (!form) return;
  const model = JSON.parse(form.querySelector(":scope > script").textContent);
  const boxes = form.querySelectorAll(".filter");
  const filters = model.filters.map((one, i) => ({ ...one, isOn: one.wasOn, box: boxes[i] }));
  const settings = Object.assign({}, ...filters.map(one => one.parameters));

  // The centres in Hz: not at the parameter's value where they follow motors or throttle, or the notch is too wide.
  const leastCentre = ({ names }) => Math.max(settings[names.centre], model.leastCentrePerWidth * settings[names.width]);
  const centres = one => {
    if (!model.isArduPilot) return [settings[one.names.centre]];
    if (one.motors.length) return one.motors.map(frequency => Math.max(frequency, leastCentre(one)));
    return Array(one.sources).fill(leastCentre(one) * one.hoverRatio);
  };

  // The notches of a filter in series: centre in Hz, damping 1/Q of the poles, and gain at the centre.
  const notchesOf = one => {
    const { names } = one, width = settings[names.width];
    if (!one.isOn || !(settings[names.centre] > 0 && width > 0)) return [];
    if (!model.isArduPilot) {
      const [centre] = centres(one);
      if (centre >= model.maxRatio * model.rate) return [];
      const alpha = Math.tan(Math.PI * Math.min(width / model.rate, model.maxRatio));
      return [{ centre, damping: 2 * alpha / Math.sin(2 * Math.PI * centre / model.rate), gain: 0 }];
    }
    const half = width / leastCentre(one) / 2;
    const damping = half * (2 - half) / (1 - half), gain = 10 ** (-settings[names.depth] / 20), all = [];
    if (!(settings[names.depth] > 0)) return [];
    for (const fundamental of centres(one))
      for (let multiple = 1; multiple <= model.mostHarmonics; multiple++) {
        const centre = multiple * fundamental, isChosen = settings[names.harmonics] >> (multiple - 1) & 1;
        if (isChosen && centre < model.maxRatio * model.rate) all.push({ centre, damping, gain });
      }
    return all;
  };
  const notches = () => filters.flatMap(notchesOf);

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
    const values = Object.assign({}, settings, ...filters.map(one => one.isOn ? {} : one.off));
    for (const [name, value] of Object.entries(values))
      text = text.replace(new RegExp(`((?:^|\\t)${name}[,\\t])[^\\t\\n]+`, "m"), `$1${Number(value.toPrecision(9))}`);
    // Of a filter that is off, and was off in the log, only its switch is written: the rest has no place on the vehicle.
    for (const one of filters.filter(one => !one.isOn && !one.wasOn))
      for (const name of Object.keys(one.parameters).filter(name => !(name in one.off)))
        text = text.replace(new RegExp(`^(?:.*\\t)?${name}[,\\t].*\\n?`, "m"), "");
    return text;
  };

  // Where the centres of a filter are, if not where its slider has them.
  const movedText = one => {
    const moved = centres(one).filter(centre => Math.abs(centre - settings[one.names.centre]) >= 0.5);
    if (!notchesOf(one).length || !moved.length) return "";
    const places = [...new Set(moved.map(centre => shown(centre, 0)))], owner = one.title ? `${one.title}: the` : "Its";
    return `${owner} centre${places.length > 1 ? "s are" : " is"} at ${places.join(", ")} Hz. `;
  };

  // What the filters take of the strongest peak; nothing if the spectrum has no peak.
  const peakText = all => {
    if (model.peak == null) return "";
    const gain = decibels(response(all, model.peak).gain), deepest = gain <= decibels(0) ? "at least " : "";
    return `At the peak of ${shown(model.peak, 0)} Hz ${filters.length > 1 ? "they take" : "it takes"} ${deepest}${shown(-gain)} dB. `;
  };

  const update = () => {
    for (const slider of form.querySelectorAll("input[type=range]")) {
      const text = `${Number(settings[slider.name].toPrecision(4))} ${slider.dataset.unit}`;
      slider.nextElementSibling.textContent = text;
      slider.setAttribute("aria-valuetext", text);
    }
    const all = notches(), { phase } = response(all, model.crossover);
    form.querySelector(".effects").textContent = filters.map(movedText).join("") + peakText(all)
      + `${model.place} ${shown(model.crossover)} Hz ${filters.length > 1 ? "they cost" : "it costs"} ${shown(-phase)}° of phase`
      + (filters.some(one => one.wasOn) ? `; as logged, ${shown(-before)}°.` : ".");
    form.querySelectorAll("a.button").forEach((link, i) => {
      link.download = model.files[i].name;
      link.href = `data:text/plain;charset=utf-8,${encodeURIComponent(fileText(model.files[i].text))}`;
    });
    drawCharts(all);
  };

  const switchOn = one => one.box.querySelector("[name=on]").checked = one.isOn = true;
  form.addEventListener("input", ({ target }) => {
    const one = filters.find(({ box }) => box.contains(target)), { harmonics } = one.names;
    if (target.type === "range") {
      settings[target.name] = target.valueAsNumber;
      // Who moves a slider wants to see what it does.
      switchOn(one);
    } else if (target.name === "harmonic") {
      const bit = 1 << (target.value - 1), mask = settings[harmonics];
      settings[harmonics] = target.checked ? mask | bit : mask & ~bit;
      switchOn(one);
    } else one.isOn = target.checked;
    update();
  });
  form.addEventListener("submit", event => event.preventDefault());
  update();
  root.notch = { response: frequency => response(notches(), frequency) };
})();
