// What a page does besides its charts: the map and the line of words that follow their cursor, events that move the
// plots, parts that open where a link leads to them and for print, contents that fold, and the search of tables.
(() => {
  const root = document.documentElement, { groups, zoom, setCursor, unpack, digits } = root.charts;
  const flight = () => groups.flight;

  // The map of the flown path: a dot at the cursor's time, the wind then, and the charts' cursor at the point under the
  // pointer. A sample of the path with a time has its place in units of the drawing.
  const map = document.querySelector(".map figure"), track = map && JSON.parse(map.querySelector("script").textContent);
  if (track) for (const name of ["time", "x", "y", "height", "direction", "speed"]) track[name] = unpack(track[name], false);
  const sampleAt = time => {
    let low = 0, high = track.time.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (track.time[middle] > time) high = middle; else low = middle;
    }
    return time - track.time[low] < track.time[high] - time ? low : high;
  };
  const now = document.getElementById("now"), hint = now?.textContent, rows = [...document.querySelectorAll("tr[data-at]")];
  let shownTime = null;
  root.addEventListener("cursor", ({ detail: time }) => {
    if (time === shownTime) return;
    shownTime = time;
    const words = time == null ? [] : [`${time.toFixed(1)} s`];
    if (time != null) {
      const mode = flight()?.modes?.find(([start, end]) => start <= time && time <= end);
      if (mode) words.push(mode[2]);
    }
    if (track) {
      const dot = map.querySelector(".here"), arrow = map.querySelector(".arrow-now"), number = time == null ? 0 : sampleAt(time);
      dot.style.visibility = time == null ? "hidden" : "visible";
      dot.setAttribute("transform", `translate(${track.x[number]} ${track.y[number]})`);
      if (time != null && track.height[number] != null) words.push(`${digits(Number(track.height[number].toFixed(1)))} m high`);
      if (arrow && track.direction?.[number] != null) {
        arrow.setAttribute("transform", `rotate(${track.direction[number]})`);
        if (time != null && track.speed?.[number] != null) words.push(`wind ${digits(Number(track.speed[number].toFixed(1)))} m/s`);
      }
    }
    if (time != null && flight()) {
      // Events within a hundredth of what is shown.
      const near = (flight().charts[0].scales.x.max - flight().charts[0].scales.x.min) / 100;
      const events = rows.filter(row => Math.abs(row.dataset.at - time) <= near).map(row => [row.querySelector(".number")?.textContent, row.querySelector(".sentence").textContent]);
      // An event may be in both lists: the brief one comes first.
      words.push(...events.filter(([number], i) => events.findIndex(other => other[0] === number) === i).map(event => event.join(" ")));
    }
    if (now) now.textContent = words.join(" · ") || hint;
  });
  map?.querySelector("svg").addEventListener("pointermove", event => {
    if (!flight()) return;
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(event.currentTarget.getScreenCTM().inverse());
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
  const followAddress = () => {
    let end = location.hash.slice(1);
    try { end = decodeURIComponent(end); } catch { /* An address that is not encoded well is taken as it is. */ }
    const time = /^t=(-?[\d.]+)$/.exec(end)?.[1];
    for (const row of rows) row.classList.toggle("shown", time != null && Math.abs(row.dataset.at - time) < 0.01);
    if (time == null) {
      if (root.eventShown && flight()) zoom(flight(), ...flight().whole);
      root.eventShown = false;
      const part = document.getElementById(end), details = part?.querySelector(":scope > details");
      for (let closed = details ?? part; closed; closed = closed.parentElement) if (closed.tagName === "DETAILS") closed.open = true;
      if (details) part.scrollIntoView();
      return;
    }
    if (!flight()) return;
    const [first, last] = flight().whole;
    root.eventShown = true;
    zoom(flight(), Math.max(+time - 5, first), Math.min(+time + 5, last));
    // The charts take their new span before the next picture, and the cursor its place in it.
    requestAnimationFrame(() => setCursor(flight(), +time));
    document.querySelector("#flight .charts")?.scrollIntoView({ block: "nearest" });
  };
  addEventListener("hashchange", followAddress);
  root.addEventListener("drawn", followAddress);
  // A second click on an event goes back.
  for (const row of rows) row.addEventListener("click", event => {
    const address = row.querySelector("a").hash;
    event.preventDefault();
    location.hash = location.hash === address ? "#flight" : address;
  });
  document.getElementById("whole")?.addEventListener("click", () => flight() && zoom(flight(), ...flight().whole));

  const parts = [...document.querySelectorAll("main details")], all = document.getElementById("all");
  all?.addEventListener("click", () => {
    const chapters = parts.filter(part => part.matches(".chapter > details, .part")), open = chapters.some(part => !part.open);
    for (const part of chapters) part.open = open;
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

  // On a phone the list of contents is closed until it is wanted, and after it was used; and the plots of all axes but
  // the one that decides.
  const contents = document.querySelector(".contents > details"), phone = matchMedia("(max-width: 600px)");
  const foldContents = () => { if (contents) contents.open = !phone.matches; };
  const foldAll = () => {
    foldContents();
    for (const column of document.querySelectorAll(".fold:not(.first)")) column.open = !phone.matches;
  };
  phone.addEventListener("change", foldAll);
  contents?.addEventListener("click", event => event.target.closest("a") && foldContents());
  foldAll();

  // A page of a session that goes on is loaded again every few seconds. The new one has open what its reader opened, the
  // same zoom, which follows the end of the flight if it reached to it, and the keyboard at the same place.
  if (document.querySelector("section.live")) {
    const key = `reading ${location.pathname}`, titleOf = part => part.querySelector("summary").textContent;
    const places = "a, button, summary, select, [tabindex]", shownNameOf = place => place.getAttribute("href") ?? place.querySelector("h3")?.textContent ?? place.textContent;
    const nameOf = place => place.tagName + shownNameOf(place);
    let reading = null;
    try { reading = JSON.parse(sessionStorage.getItem(key)); } catch { /* A browser may keep nothing. */ }
    if (reading) {
      for (const part of parts) part.open = reading.open[titleOf(part)] ?? part.open;
      root.addEventListener("drawn", () => {
        if (reading.span && flight()) {
          const later = reading.isAtEnd ? flight().whole[1] - reading.span[1] : 0;
          zoom(flight(), reading.span[0] + later, reading.span[1] + later);
        }
        [...document.querySelectorAll(places)].find(place => nameOf(place) === reading.focused)?.focus({ preventScroll: true });
      });
    }
    addEventListener("pagehide", () => {
      const { span, whole } = flight() ?? {}, focused = document.activeElement, isZoomed = span && (span[0] > whole[0] || span[1] < whole[1]);
      const kept = {
        open: Object.fromEntries(parts.map(part => [titleOf(part), part.open])),
        span: isZoomed ? span : null, isAtEnd: isZoomed && span[1] >= whole[1],
        focused: focused?.matches(places) ? nameOf(focused) : null,
      };
      try { sessionStorage.setItem(key, JSON.stringify(kept)); } catch { /* As above. */ }
    });
  }

  // On paper all is open but what only serves a screen: a list that is fetched as it opens is not fetched.
  let closedParts = [];
  addEventListener("beforeprint", () => {
    closedParts = parts.filter(part => !part.open && !part.matches(".on-screen"));
    for (const part of closedParts) part.open = true;
  }, true); // before the charts are drawn for paper
  addEventListener("afterprint", () => { for (const part of closedParts) part.open = false; });
})();
