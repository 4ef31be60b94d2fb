// What a page does besides its charts: the map and the line of words that follow their cursor, events that move the
// plots, parts that open where a link leads to them and for print, contents that fold, and the search of tables. A part
// that a page of a session gets while it is open works like the others: the event "renewed" comes after such changes.
(() => {
  const root = document.documentElement, { groups, zoom, setCursor, unpack, digits, compassText } = root.charts;
  const flight = () => groups.flight, eventRows = () => [...document.querySelectorAll("tr[data-at]")];
  // Calls an action at each click on what a selector finds, also where it comes later.
  const onClick = (selector, action) => document.addEventListener("click", event => {
    const target = event.target.closest?.(selector);
    if (target) action(target, event);
  });

  // The map of the flown path: a dot at the cursor's time, the wind then, and the charts' cursor at the point under the
  // pointer. A sample of the path with a time has its place in units of the drawing.
  let map, track;
  const readMap = () => {
    map = document.querySelector(".map figure");
    track = map && JSON.parse(map.querySelector("script").textContent);
    if (track) for (const name of ["time", "x", "y", "height", "direction"]) track[name] = unpack(track[name], false);
  };
  readMap();
  const sampleAt = time => {
    let low = 0, high = track.time.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (track.time[middle] > time) high = middle; else low = middle;
    }
    return time - track.time[low] < track.time[high] - time ? low : high;
  };
  let hint = document.getElementById("now")?.textContent, shownTime = null;
  root.addEventListener("cursor", ({ detail: time }) => {
    if (time === shownTime) return;
    shownTime = time;
    showMoment(time);
  });
  const showMoment = time => {
    const now = document.getElementById("now"), words = time == null ? [] : [`${time.toFixed(1)} s`];
    if (time != null) {
      const mode = flight()?.modes?.find(([start, end]) => start <= time && time <= end);
      if (mode) words.push(mode[2]);
    }
    if (track) {
      const dot = map.querySelector(".here"), arrow = map.querySelector(".arrow-now"), number = time == null ? 0 : sampleAt(time);
      // A path that ends at a loss says nothing of the place after it.
      const isOnPath = time != null && Math.abs(track.time[number] - time) <= 3 * (track.time.at(-1) - track.time[0]) / track.time.length;
      dot.style.visibility = isOnPath ? "visible" : "hidden";
      dot.setAttribute("transform", `translate(${track.x[number]} ${track.y[number]})`);
      if (isOnPath && track.height[number] != null) words.push(`${digits(Number(track.height[number].toFixed(1)))} m high`);
      // The arrow and its label show the wind then, and without a cursor the mean wind. The speed then stands in the legend
      // of its chart: the path has fewer points than that.
      const label = map.querySelector(".wind-label"), direction = isOnPath ? track.direction?.[number] : null;
      if (arrow && track.direction) {
        track.meanWind ??= { turn: arrow.getAttribute("transform"), text: label.textContent };
        arrow.setAttribute("transform", direction == null ? track.meanWind.turn : `rotate(${direction})`);
        label.textContent = direction == null ? track.meanWind.text : `wind at ${time.toFixed(0)} s from ${compassText(direction)}`;
      }
    }
    // While a flight of other plots begins or ends, there may be none for a moment.
    if (time != null && flight()?.charts.length) {
      // Events within a hundredth of what is shown; the autopilot's messages, which have no sentence, are not among them.
      const near = (flight().charts[0].scales.x.max - flight().charts[0].scales.x.min) / 100;
      const events = eventRows().filter(row => row.querySelector(".sentence") && Math.abs(row.dataset.at - time) <= near).map(row => [row.querySelector(".number")?.textContent, row.querySelector(".sentence").textContent]);
      // An event may be in both lists: the brief one comes first.
      words.push(...events.filter(([number], i) => events.findIndex(other => other[0] === number) === i).map(event => event.join(" ")));
    }
    now?.classList.toggle("held", words.length > 0);
    if (now) now.textContent = words.join(" · ") || (hint ??= now.textContent);
  };
  document.addEventListener("pointermove", event => {
    const drawing = event.target.closest?.(".map svg");
    if (!drawing || !flight()) return;
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(drawing.getScreenCTM().inverse());
    let nearest = 0, least = Infinity;
    track.x.forEach((x, i) => {
      const distance = Math.hypot(x - place.x, track.y[i] - place.y);
      if (distance < least) [nearest, least] = [i, distance];
    });
    const { min, max } = flight().charts[0].scales.x, time = track.time[nearest];
    if (time >= min && time <= max) setCursor(flight(), time);
  });

  // An address that ends in "#t=12.3" shows the plots around that time; when it goes, so does the zoom. Any other end is
  // the name of a part, which is opened.
  const endOfAddress = () => {
    const end = location.hash.slice(1);
    try { return decodeURIComponent(end); } catch { return end; /* An address that is not encoded well is taken as it is. */ }
  };
  const timeOf = end => /^t=(-?[\d.]+)$/.exec(end)?.[1];
  const markEvent = time => {
    for (const row of eventRows()) row.classList.toggle("shown", time != null && Math.abs(row.dataset.at - time) < 0.01);
  };
  // What the plots show once no event is chosen any more: the whole flight, unless the script of a session says otherwise.
  root.showUsualSpan = () => zoom(flight(), ...flight().whole);
  const followAddress = () => {
    const end = endOfAddress(), time = timeOf(end);
    markEvent(time);
    if (time == null) {
      if (root.eventShown && flight()) root.showUsualSpan();
      root.eventShown = false;
      const part = document.getElementById(end), details = part?.querySelector(":scope.chapter > details");
      for (let closed = details ?? part; closed; closed = closed.parentElement) if (closed.tagName === "DETAILS") closed.open = true;
      if (details) part.scrollIntoView();
      return;
    }
    if (!flight()) return;
    // What was written before or after the plots leads to their begin or end.
    const [first, last] = flight().whole, place = Math.min(Math.max(+time, first), last);
    root.eventShown = true;
    zoom(flight(), Math.max(place - 5, first), Math.min(place + 5, last));
    // The charts take their new span before the next picture, and the cursor its place in it.
    requestAnimationFrame(() => setCursor(flight(), place));
    // A short list above the plots stays on the screen with them, so that its next event is one click away.
    const part = document.getElementById("flight"), plots = part.querySelector(".charts");
    const isListShort = plots.getBoundingClientRect().top - part.getBoundingClientRect().top < innerHeight / 2;
    (isListShort ? part : plots).scrollIntoView({ block: isListShort ? "start" : "nearest" });
  };
  addEventListener("hashchange", followAddress);
  root.addEventListener("drawn", followAddress);
  // A second click on an event goes back.
  onClick("tr[data-at]", (row, event) => {
    const address = row.querySelector("a").hash;
    event.preventDefault();
    location.hash = location.hash === address ? "#flight" : address;
  });
  onClick("#whole", () => flight() && zoom(flight(), ...flight().whole));

  // Every part of the page that opens, but the contents, tools that serve a screen, and a trial of filters that are off.
  const allParts = () => [...document.querySelectorAll("main details:not(.contents > details, .on-screen details, .idle)")];
  onClick("#all", all => {
    const open = allParts().some(part => !part.open);
    for (const part of allParts()) part.open = open;
    all.textContent = open ? "Close all" : "Open all";
  });

  // A search shows the rows of the table below it that have all its words.
  for (const search of document.querySelectorAll("input[data-table]")) search.addEventListener("input", () => {
    const words = search.value.toLowerCase().split(/\s+/);
    const { rows } = document.getElementById(search.dataset.table).tBodies[0];
    for (const row of rows) row.hidden = !words.every(word => row.textContent.toLowerCase().includes(word));
    const shown = [...rows].filter(row => !row.hidden).length;
    search.closest("p").querySelector("[role=status]").textContent = `${shown < rows.length ? `${shown} of ` : ""}${rows.length} rows`;
  });

  // On a phone the list of contents is closed until it is wanted, and after it was used or the page beside it was touched; the plots of all axes but
  // the one that decides; and chapters that a phone closes.
  const phone = matchMedia("(max-width: 600px)"), folded = new WeakSet();
  const fold = () => {
    for (const part of document.querySelectorAll(".contents > details, .fold:not(.first), .phone-closed")) {
      if (!folded.has(part)) part.open = !phone.matches;
      folded.add(part);
    }
  };
  phone.addEventListener("change", () => {
    for (const part of document.querySelectorAll(".contents > details, .fold:not(.first), .phone-closed")) part.open = !phone.matches;
  });
  onClick(".contents a", link => { link.closest("details").open = !phone.matches; });
  document.addEventListener("click", event => {
    if (phone.matches && !event.target.closest?.(".contents")) for (const part of document.querySelectorAll(".contents > details[open]")) part.open = false;
  });
  // Whoever scrolls on has read the contents. Their opening itself moves the page by less.
  const SCROLL_PAST_CONTENTS = 60;
  let scrollAtOpening = 0;
  document.addEventListener("toggle", ({ target }) => {
    if (target.matches(".contents > details")) scrollAtOpening = scrollY;
  }, true);
  document.addEventListener("scroll", ({ target }) => {
    if (!phone.matches || target !== document || Math.abs(scrollY - scrollAtOpening) < SCROLL_PAST_CONTENTS) return;
    for (const part of document.querySelectorAll(".contents > details[open]")) part.open = false;
  }, true);
  fold();

  // What a session shows anew has a map of its own, parts that were not folded yet, and events that are not marked.
  root.addEventListener("renewed", () => {
    readMap();
    fold();
    markEvent(timeOf(endOfAddress()));
    showMoment(shownTime);
  });

  // Paper has what is open on the screen, and also: chapters that warn, the plots and gains that the top of the page folds,
  // and a list of all events that is not long, in the place of the short one. One line names all that stays closed.
  const MAX_PRINTED_EVENTS = 20; // a choice: with their evidence they take less than half a sheet
  const closedForScreen = () => {
    const parts = [...document.querySelectorAll("main :is(.fold, .gains):not([open]), #flight:not(.session) > .more:not([open]), .chapter > details:not([open]):has(> summary > .rating:is(.watch, .bad))")];
    const allEvents = document.querySelector("#flight:not(.session) > details.events:not([open])");
    if (allEvents?.querySelectorAll("tr").length <= MAX_PRINTED_EVENTS) parts.push(allEvents);
    return parts;
  };
  let openedParts = [], unprintedParts = [];
  // The charts ask for it before they are drawn for paper.
  root.addEventListener("openforpaper", () => {
    openedParts = closedForScreen();
    for (const part of openedParts) part.open = true;
    // A closed part with a sentence on what it is about is printed as that; one without would be a heading over nothing.
    const closedEvents = document.querySelector("#flight:not(.session) > details.events:not([open]) > summary");
    unprintedParts = [...document.querySelectorAll(".chapter:has(> details:not([open])), .chapter > details[open] > .part:not([open]):has(> summary > strong:only-child)")];
    for (const part of unprintedParts) part.classList.add("unprinted");
    const titles = unprintedParts.map(part => part.querySelector("h2, strong").textContent);
    if (closedEvents) titles.unshift(closedEvents.textContent);
    const line = document.getElementById("unprinted"), words = `Closed, not printed: ${titles.join(", ")}. “Open all” on the page prints all but long lists.`;
    if (line) line.textContent = titles.length ? words : "";
  });
  addEventListener("afterprint", () => {
    for (const part of openedParts) part.open = false;
    for (const part of unprintedParts) part.classList.remove("unprinted");
  });
})();
