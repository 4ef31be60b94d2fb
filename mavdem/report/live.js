// Keeps the page of a session up to date: the server sends what has changed, and it takes the place of what was there, so
// that scroll, opened parts, the cursor, the zoom and the keyboard stay where they are. While the server does not answer,
// the page keeps its last state, looks old, and says for how long.
(() => {
  const root = document.documentElement, { charts, updates } = root, main = document.querySelector("main");
  // Seconds without an answer after which the page says so: the server answers within two seconds.
  const LONGEST_SILENCE = 5;

  // Parts that scripts fill, or that a click changes.
  const OWN_PARTS = "#now, #all, #span", KEPT_ATTRIBUTES = ["open", "data-open"];
  const nameOf = node => {
    if (node.nodeType !== Node.ELEMENT_NODE) return node.nodeName;
    const title = node.tagName === "TR" ? node.textContent : node.matches("figure, details") ? node.querySelector("h3, summary")?.textContent : "";
    return [node.tagName, node.id, node.dataset.light, title].join(" ");
  };
  // Makes a part of the page like a newer one, and keeps every element that is in both.
  const renew = (part, newer) => {
    if (part.nodeType !== Node.ELEMENT_NODE) {
      if (part.data !== newer.data) part.data = newer.data;
      return;
    }
    if (part.matches("figure.chart")) return charts.renew(part, newer);
    if (part.matches(OWN_PARTS) || part.isEqualNode(newer)) return;
    for (const { name } of [...part.attributes]) if (!newer.hasAttribute(name) && !KEPT_ATTRIBUTES.includes(name)) part.removeAttribute(name);
    for (const { name, value } of newer.attributes) if (!KEPT_ATTRIBUTES.includes(name) && part.getAttribute(name) !== value) part.setAttribute(name, value);
    let next = part.firstChild;
    for (const child of [...newer.childNodes]) {
      let same = next;
      // The white space between two elements is like any other: one further on does not stand for it.
      const isText = child.nodeType !== Node.ELEMENT_NODE;
      while (same && nameOf(same) !== nameOf(child)) same = isText ? null : same.nextSibling;
      if (!same) {
        part.insertBefore(child, next);
        observeCharts(child, charts.observe);
        continue;
      }
      // What stands between has no counterpart in the newer page.
      while (next !== same) next = removed(next);
      next = same.nextSibling;
      renew(same, child);
    }
    while (next) next = removed(next);
  };
  const removed = node => {
    const next = node.nextSibling;
    observeCharts(node, charts.forget);
    node.remove();
    return next;
  };
  const observeCharts = (node, action) => {
    if (node.nodeType === Node.ELEMENT_NODE) for (const figure of [node, ...node.querySelectorAll("figure.chart")]) if (figure.matches("figure.chart")) action(figure);
  };

  // On a narrow screen a touch opens a light, and another one closes it. Its link leads to the plot of its own.
  addEventListener("click", event => {
    const light = event.target.closest?.("[data-light]"), link = event.target.closest?.("a");
    if (!light) return;
    if (!link) {
      if (!light.toggleAttribute("data-open")) light.blur();
      return;
    }
    const plot = plotOf(light.querySelector("dt").textContent);
    if (!plot) return;
    event.preventDefault();
    plot.scrollIntoView();
  });

  // The library stores that the fault of an earlier flight was repaired. The button and the headline of that fault say so at
  // once, and the next states of the page, which may still have them for some seconds, do not state them again. Each repair
  // is a statement by the address of its flight.
  const notedRepairs = new Map();
  // Headline and next step as the server sent them last, which stand again where it stores nothing.
  let newestResult = document.getElementById("result").cloneNode(true);
  const markNotedRepair = () => {
    const repair = document.getElementById("repaired");
    if (!repair || !notedRepairs.has(repair.value)) return;
    const statement = notedRepairs.get(repair.value), result = repair.closest("#result"), headline = result?.querySelector(".headline strong");
    repair.disabled = true;
    repair.textContent = "Noted";
    // The next step below the headline leads to that flight only where the headline states its fault.
    const step = result?.querySelector(".headline + p a");
    if (!headline || step?.getAttribute("href") !== repair.value) return;
    headline.textContent = `Noted: ${statement[0].toLowerCase()}${statement.slice(1)}.`;
    result.classList.add("noted");
  };
  document.addEventListener("click", async ({ target }) => {
    if (target.id !== "repaired") return;
    const statement = target.textContent, address = target.value;
    if (!confirm(`${statement}?\n\nThe warning then ends. The library keeps today’s date, and can take it back.`)) return;
    const key = document.querySelector('meta[name="mavdem-key"]')?.content, headers = { "Content-Type": "application/json" };
    if (key) headers.Authorization = `Bearer ${key}`;
    const options = { method: "PATCH", headers, body: JSON.stringify({ repaired: true }) };
    notedRepairs.set(address, statement);
    markNotedRepair();
    try {
      const response = await fetch(address.replace("/f/", "/api/flights/"), options);
      if (response.ok) return;
      const { error } = await response.json();
      alert([error?.reason, error?.remedy].filter(Boolean).join(" ") || response.statusText);
    } catch { alert("mavdem does not answer: nothing was stored."); }
    notedRepairs.delete(address);
    target.disabled = false;
    target.textContent = statement;
    renew(document.getElementById("result"), newestResult.cloneNode(true));
  });

  // A plot is not changed under a finger or a pressed button, which may be choosing what to zoom to. Where a menu opens, or
  // another window has the focus, the end of the press is not reported.
  let isPressed = false;
  const release = () => { isPressed = false; };
  addEventListener("pointerdown", () => { isPressed = true; }, true);
  for (const kind of ["pointerup", "pointercancel", "contextmenu"]) addEventListener(kind, release, true);
  addEventListener("blur", release);

  // A light whose text is longer than its place says that it opens.
  const markLongLights = () => {
    for (const light of document.querySelectorAll("[data-light]")) {
      const text = light.lastElementChild;
      if (light.hasAttribute("data-open") || light.contains(document.activeElement)) continue;
      // The words "… more" take room, which a text that has become shorter needs no more.
      light.classList.remove("cut");
      light.classList.toggle("cut", text.scrollHeight > text.clientHeight + 1);
    }
  };
  root.addEventListener("renewed", markLongLights);
  addEventListener("resize", markLongLights);
  markLongLights();

  // The page's title; that of the tab begins with what is wrong.
  let title = document.title;

  // The sign of the tab has the colour of the headline, and is grey while nothing is known of now.
  const icon = Object.assign(document.createElement("link"), { rel: "icon" });
  document.head.append(icon);
  const colourIcon = level => {
    const colour = getComputedStyle(root).getPropertyValue(`--${level}`), shape = `<circle cx="8" cy="8" r="7" fill="${colour}"/>`;
    icon.href = `data:image/svg+xml,${encodeURIComponent(`<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16">${shape}</svg>`)}`;
  };

  // Choices that are remembered. A browser may keep nothing.
  const remembered = key => {
    try { return localStorage.getItem(key); } catch { return null; }
  };
  const remember = (key, value) => {
    try { localStorage.setItem(key, value); } catch { /* The next page begins with the usual choice. */ }
  };

  // The sound of alarms, which a browser allows once its user has touched the page. The choice is remembered.
  const SOUND_KEY = "mavdem sound", button = Object.assign(document.createElement("button"), { id: "sound", type: "button" });
  let sounds = remembered(SOUND_KEY) === "on", player = null;
  const showSound = () => {
    const isSilent = sounds && player?.state !== "running";
    button.textContent = isSilent ? "Touch for alarm sound" : sounds ? "Alarm sound is on" : "Turn on alarm sound";
    button.setAttribute("aria-pressed", sounds);
    button.classList.toggle("silent", isSilent);
  };
  const wake = () => {
    if (!sounds) return;
    player ??= new AudioContext();
    player.onstatechange = showSound;
    player.resume();
  };
  // Beeps of a frequency, Hz, each of a fifth of a second.
  const sound = (frequency, count) => {
    if (!sounds || !player) return;
    for (let beep = 0; beep < count; beep++) {
      const tone = new OscillatorNode(player, { type: "square", frequency }), volume = new GainNode(player, { gain: 0.3 }), start = player.currentTime + 0.3 * beep;
      tone.connect(volume).connect(player.destination);
      tone.start(start);
      tone.stop(start + 0.2);
    }
    navigator.vibrate?.(Array(2 * count - 1).fill(200));
  };
  button.addEventListener("click", () => {
    // A page that waits for a touch has had it now.
    if (!sounds || player) remember(SOUND_KEY, (sounds = !sounds) ? "on" : "off");
    wake();
    if (sounds) sound(880, 1);
    showSound();
  });
  addEventListener("pointerdown", event => { if (event.target !== button) wake(); }, true);
  document.body.append(button);
  showSound();

  // The plots follow the last seconds of the flight, or show all of it. A reader who zooms sees neither, until the next click.
  // On the width of a telephone, 30 s of quick motion are one block of colour.
  const LAST_SECONDS = matchMedia("(max-width: 600px)").matches ? 10 : 30, SPAN_KEY = "mavdem span", WHOLE = "whole", LAST = "last";
  let chosenSpan = remembered(SPAN_KEY) ?? LAST, shownSpan = chosenSpan;
  const endsOf = span => {
    const [first, last] = charts.groups.flight.whole;
    return [span === LAST ? Math.max(first, last - LAST_SECONDS) : first, last];
  };
  const isShown = span => endsOf(span).every((end, i) => Math.abs(end - charts.groups.flight.span[i]) < 0.01);
  const pressSpan = () => {
    for (const choice of document.querySelectorAll("#span button")) {
      if (choice.value === LAST) choice.textContent = `Last ${LAST_SECONDS} s`;
      choice.setAttribute("aria-pressed", choice.value === shownSpan);
    }
  };
  const showSpan = () => {
    if (shownSpan && charts.groups.flight?.whole) charts.zoom(charts.groups.flight, ...endsOf(shownSpan));
    pressSpan();
  };
  root.showUsualSpan = () => {
    shownSpan = chosenSpan;
    showSpan();
  };
  root.addEventListener("zoomed", ({ detail: group }) => {
    if (group !== charts.groups.flight) return;
    // Of a short flight both are the same.
    shownSpan = [chosenSpan, LAST, WHOLE].find(isShown) ?? null;
    pressSpan();
  });
  root.addEventListener("drawn", () => { if (!root.eventShown) showSpan(); });
  document.addEventListener("click", event => {
    const choice = event.target.closest?.("#span button");
    if (!choice) return;
    chosenSpan = shownSpan = choice.value;
    remember(SPAN_KEY, chosenSpan);
    showSpan();
  });
  pressSpan();

  // On a telephone, where the page is several screens long, a bar leads to its parts.
  const jump = Object.assign(document.createElement("nav"), { id: "jump" });
  jump.setAttribute("aria-label", "Parts of this page");
  const plotOf = name => [...document.querySelectorAll("#flight figure h3")].find(title => title.textContent.startsWith(name));
  const PARTS = {
    Lights: () => document.querySelector("h1"), Events: () => document.querySelector("#flight h2"), Motors: () => plotOf("Motors"),
    Height: () => plotOf("Height"), Map: () => plotOf("Flown path"), Battery: () => plotOf("Battery"),
  };
  const showJumps = () => {
    for (const link of jump.children) link.hidden = !PARTS[link.textContent]();
  };
  for (const name of Object.keys(PARTS)) jump.append(Object.assign(document.createElement("button"), { type: "button", textContent: name }));
  jump.addEventListener("click", ({ target }) => {
    const part = PARTS[target.textContent]?.(), closed = part?.closest("details:not([open])");
    if (closed) closed.open = true;
    part?.scrollIntoView();
  });
  document.body.append(jump);
  showJumps();

  // After the last page of a server no alarm sounds. The page goes on as soon as a server answers at its address again.
  const isLast = () => main.dataset.level === undefined;
  // Before it stands one that says that the session ends, which takes its time.
  const isEnding = () => main.dataset.ending !== undefined;

  // What the tab shows and sounds of the newest state.
  let alarms = +main.dataset.alarms;
  const announce = () => {
    const newest = +main.dataset.alarms;
    if (newest > alarms) sound(880, 5);
    alarms = newest;
    button.hidden = isLast();
    document.title = title;
    colourIcon(main.dataset.level ?? "unknown");
  };
  announce();

  // The line that says how old the page is stands above everything, where it stays while the page is scrolled.
  const line = Object.assign(document.createElement("p"), { id: "unanswered", hidden: true });
  line.setAttribute("role", "alert");
  document.body.prepend(line);

  // The alarm at the edge of the window, while the headline that states it is scrolled out of sight. A page that gets no
  // answer states the last one in the line above it.
  const strip = Object.assign(document.createElement("button"), { id: "alarm", type: "button", hidden: true });
  strip.setAttribute("role", "alert");
  strip.addEventListener("click", () => scrollTo({ top: 0 }));
  document.body.append(strip);
  const isHeadlineInSight = () => document.querySelector("#result .headline")?.getBoundingClientRect().bottom > 0;
  const showAlarm = () => {
    const text = main.dataset.alarm ?? "";
    if (strip.textContent !== text) strip.textContent = text;
    strip.classList.toggle("watch", main.dataset.level === "watch");
    // A part that is scrolled to stands below what covers the upper edge of the window, or will once it is there.
    strip.hidden = !text;
    const coveredHeight = root.classList.contains("unanswered") ? line.offsetHeight : strip.offsetHeight;
    root.style.scrollPaddingTop = coveredHeight ? `${coveredHeight + 8}px` : "";
    strip.hidden = !text || isHeadlineInSight() || root.classList.contains("unanswered");
  };
  addEventListener("scroll", showAlarm, { passive: true });
  root.addEventListener("renewed", showAlarm);
  showAlarm();

  const flightNumber = () => document.getElementById("flight")?.dataset.flight;
  const show = text => {
    const newer = new DOMParser().parseFromString(text, "text/html"), flight = charts.groups.flight;
    // Another version of the program may have other scripts and another style.
    if (newer.querySelector("footer").textContent !== main.querySelector("footer").textContent) return location.reload();
    const time = flight && charts.cursorOf(flight), shownFlight = flightNumber(), wasAtTop = isHeadlineInSight();
    // The page of a session that is over showed the whole flight, whatever was chosen.
    let followedSpan = isLast() ? chosenSpan : shownSpan;
    title = newer.title;
    newestResult = newer.querySelector("#result").cloneNode(true);
    renew(main, newer.querySelector("main"));
    markNotedRepair();
    if (flightNumber() !== shownFlight) {
      // The plots are of another flight: a zoom, or an event that was chosen, was of the one before.
      followedSpan = chosenSpan;
      root.eventShown = false;
      history.replaceState(null, "", location.pathname);
      // Who read the headline of the flight before reads that of the new one from its beginning.
      if (wasAtTop) scrollTo({ top: 0 });
    }
    announce();
    for (const group of Object.values(charts.groups)) charts.follow(group);
    // The page of a session that is over shows the whole flight.
    shownSpan = document.getElementById("span") ? followedSpan : WHOLE;
    showSpan();
    showJumps();
    if (time != null) charts.setCursor(flight, time);
    root.dispatchEvent(new Event("renewed"));
  };

  // When the server answered last, and when it made the state that is shown, ms; what it answers in the place of a state;
  // the tag of the state that is shown, and a newer one that waits.
  let answerTime = Date.now(), stateTime = Date.now(), refusal = "", tag = "", waiting = null;
  const take = answer => {
    answerTime = Date.now();
    refusal = answer.refusal ? [...new DOMParser().parseFromString(answer.refusal, "text/html").querySelectorAll("main > h1, main > p")].map(part => part.textContent).join(" ") || answer.refusal : "";
    if (answer.text) waiting = answer;
    if (waiting && !isPressed) {
      const { text } = waiting;
      ({ tag } = waiting);
      waiting = null;
      show(text);
    }
    if (!refusal && !waiting) stateTime = answerTime - 1000 * answer.age;
    tell();
    return waiting?.tag ?? tag;
  };

  const clockTime = time => new Date(time).toLocaleTimeString("en-GB");
  const tell = () => {
    line.classList.toggle("quiet", isLast());
    if (isLast()) return tellOfEnd();
    const silence = Math.round((Date.now() - answerTime) / 1000), age = Math.round((Date.now() - stateTime) / 1000);
    const words = refusal ? `mavdem does not show the session: ${refusal}`
      : silence >= LONGEST_SILENCE ? `No answer from mavdem for ${silence}\u00a0s.`
      : age < updates.LONGEST_PAUSE || isEnding() ? ""
      : waiting ? "The page does not change while something is pressed."
      : `mavdem answers, but has had nothing new for ${age}\u00a0s.`;
    if (words && line.hidden) {
      sound(440, 2);
      colourIcon("unknown");
    }
    if (!words && !line.hidden) announce();
    line.hidden = !words;
    root.classList.toggle("unanswered", !!words);
    showAlarm();
    if (!words) return;
    const lastAlarm = main.dataset.alarm ? ` Last alarm: ${main.dataset.alarm.replace("⚠ ", "")}.` : "";
    line.textContent = `${words} What is below is ${age}\u00a0s old.${lastAlarm}`;
    document.title = `⚠ ${words} — ${title}`;
  };
  // After the end of the server nothing is wrong with the page, which only says when it was answered last.
  const tellOfEnd = () => {
    root.classList.remove("unanswered");
    const isAnswered = Date.now() - answerTime < 1000 * LONGEST_SILENCE;
    const words = refusal ? `mavdem runs, but does not show the session: ${refusal}`
      : isAnswered ? "" : `mavdem does not run any more; its last answer was at ${clockTime(answerTime)}. This page goes on by itself once mavdem runs again.`;
    if (line.textContent !== words) line.textContent = words;
    line.hidden = !words;
    showAlarm();
  };
  setInterval(tell, 1000);

  updates.follow(location.pathname, take, tell, isLast);
})();
