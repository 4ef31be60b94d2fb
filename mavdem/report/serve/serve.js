"use strict";
(() => {
  const $ = id => document.getElementById(id);
  const key = document.querySelector('meta[name="mavdem-key"]')?.content || "";
  const headers = key ? { Authorization: `Bearer ${key}` } : {};
  // Sends a request to the API, and returns the JSON object of its response.
  const callApi = async (method, path, body) => {
    const options = { method, headers: { ...headers } };
    if (body !== undefined) {
      options.body = JSON.stringify(body);
      options.headers["Content-Type"] = "application/json";
    }
    const response = await fetch(path, options), content = response.status === 204 ? {} : await response.json();
    if (!response.ok) throw new Error([content.error?.reason, content.error?.remedy].filter(Boolean).join(" ") || response.statusText);
    return content;
  };
  const marks = { good: "●", watch: "▲", bad: "■", unknown: "–" };
  const element = (tag, text, parent, className) => {
    const node = document.createElement(tag);
    node.textContent = text;
    if (className) node.className = className;
    parent?.append(node);
    return node;
  };
  const showLights = (container, lights) => {
    container.replaceChildren();
    for (const [name, level] of Object.entries(lights)) element("span", `${marks[level]} ${name}`, container, level);
  };

  // The table of flights: search as one types, choice, and what is being read.
  const searchForm = $("find"), flightRows = () => $("flights")?.tBodies[0];
  const chosenIds = () => [...document.querySelectorAll('#flights input[name="id"]:checked')].map(box => box.value);
  const rowOf = id => flightRows()?.querySelector(`tr[data-id="${id}"]`), nameIn = row => row.querySelector(".name").textContent;
  let baselineNote = "";
  const updateButtons = () => {
    const count = chosenIds().length;
    const unread = document.querySelector("#flights input[data-unread]:checked");
    if ($("compare")) $("compare").disabled = count !== 2 || unread;
    const unnamed = document.querySelector("#flights input[data-unnamed]:checked");
    if ($("baseline")) {
      $("baseline").disabled = !count || unread || unnamed;
      $("baseline").title = unnamed ? "A chosen log does not name its vehicle, whose other flights are compared with a baseline." : "";
    }
    if ($("remove")) $("remove").disabled = !count;
    if ($("assign")) $("assign").disabled = !count;
    if ($("chosen")) $("chosen").textContent = count ? `${count} chosen` : baselineNote;
  };
  document.addEventListener("change", event => { if (event.target.name === "id") updateButtons(); });
  updateButtons();
  // On the way back a browser ticks the boxes as they were, after this script has run.
  addEventListener("pageshow", updateButtons);
  // The heads of columns stay below the line of the search.
  if (searchForm && $("flights")) new ResizeObserver(() => $("flights").style.setProperty("--find-height", `${searchForm.offsetHeight}px`)).observe(searchForm);
  let latestSearch = 0;
  const search = async () => {
    if (!flightRows()) return;
    const searchNumber = ++latestSearch, query = searchForm.elements.q?.value ?? "", address = new URL(location);
    if (query) address.searchParams.set("q", query); else address.searchParams.delete("q");
    if (query !== shownQuery) address.searchParams.delete("offset");
    // What is shown stays while the server does not answer.
    const response = await fetch(address, { headers }).catch(() => null);
    if (!response?.ok || searchNumber !== latestSearch) return;
    const page = new DOMParser().parseFromString(await response.text(), "text/html");
    const list = page.getElementById("flights");
    if (!list) return;
    if (list.tBodies[0].innerHTML !== shownRows) {
      // The sentences of a vehicle's page follow from its flights.
      if ($("naming")) return $("naming").contains(document.activeElement) || location.reload();
      shownRows = list.tBodies[0].innerHTML;
      const keptIds = new Set(chosenIds());
      flightRows().replaceChildren(...list.tBodies[0].rows);
      // Without a flight there are no headings of columns either.
      $("flights").parentElement.hidden = !flightRows().rows.length;
      for (const box of document.querySelectorAll('#flights input[name="id"]')) box.checked = keptIds.has(box.value);
      for (const flight of progressById.values()) showStage(flight);
    }
    // The list of an empty library is hidden until it has its first flight.
    if ($("listing")?.hidden && flightRows().rows.length) {
      $("listing").hidden = false;
      dropArea?.classList.remove("first");
      document.querySelector("h1").textContent = document.title;
    }
    // The links at the top have the count of vehicles; unchanged ones keep the focus.
    const links = document.querySelector(".top nav"), newLinks = page.querySelector(".top nav");
    if (links && newLinks && links.textContent !== newLinks.textContent) links.replaceChildren(...newLinks.childNodes);
    if ($("count")) $("count").textContent = page.getElementById("count").textContent;
    if ($("problems")) $("problems").replaceChildren(...page.getElementById("problems").children);
    if (query !== shownQuery) history.replaceState(null, "", address);
    shownQuery = query;
    updateButtons();
    watchProgress();
    followComparisons();
  };
  // Progress changes the rows of the page, but not this: the HTML that the server sent.
  let shownQuery = searchForm?.elements.q?.value ?? "", shownRows = flightRows()?.innerHTML ?? "", timer;
  const searchAfter = wait => { clearTimeout(timer); timer = setTimeout(search, wait); };
  // Flights whose motors are being compared with others have their new verdict a moment later.
  const followComparisons = () => { if (document.querySelector("#flights [data-comparing]")) searchAfter(1000); };
  followComparisons();
  searchForm?.elements.q?.addEventListener("input", () => searchAfter(150));
  $("order")?.addEventListener("change", event => {
    location = `/?${new URLSearchParams({ q: searchForm.elements.q.value, sort: event.target.value })}`;
  });
  // Enter in the search opens the only flight that is found.
  searchForm?.addEventListener("submit", async event => {
    event.preventDefault();
    clearTimeout(timer);
    const searchNumber = latestSearch + 1;
    await search();
    const found = flightRows()?.querySelectorAll("a.name") ?? [], isPart = new URL(location).searchParams.has("offset");
    if (shownQuery && found.length === 1 && !isPart && searchNumber === latestSearch) location = found[0].href;
  });
  $("compare")?.addEventListener("click", () => {
    const [b, a] = chosenIds();
    location = `/compare?a=${a}&b=${b}`;
  });
  $("baseline")?.addEventListener("click", async () => {
    const ids = chosenIds();
    const watched = ids.map(rowOf).filter(row => row.querySelector('[aria-label="motors watch"]')).map(nameIn);
    if (watched.length && !confirm(`The motors light is “watch” in:\n\n${watched.join("\n")}\n\nIn a baseline they count as healthy: a motor that is weak there is not found in other flights. Use as baseline all the same?`)) return;
    try { await callApi("PUT", "/api/baseline", { flights: ids }); } catch (error) { alert(error.message); return; }
    // The page of a vehicle names its baseline.
    if ($("naming")) { location.reload(); return; }
    baselineNote = `Baseline set: ${ids.length} flight${ids.length === 1 ? "" : "s"}. The page of the vehicle names it, and can remove it.`;
    for (const box of document.querySelectorAll('#flights input[name="id"]')) box.checked = false;
    updateButtons();
    // The rows then say that their flights are being compared with it.
    searchAfter(0);
  });
  $("nobaseline")?.addEventListener("click", async event => {
    const query = new URLSearchParams({ vehicle: event.target.dataset.vehicle });
    try { await callApi("DELETE", `/api/baseline?${query}`); location.reload(); } catch (error) { alert(error.message); }
  });
  const MAX_DELETED_NAMES = 12;
  $("remove")?.addEventListener("click", async () => {
    const ids = chosenIds();
    const names = ids.map(rowOf).map(nameIn), more = names.length - MAX_DELETED_NAMES;
    const list = names.slice(0, MAX_DELETED_NAMES).join("\n") + (more > 0 ? `\nand ${more} more` : "");
    if (!confirm(`Delete ${ids.length} flight${ids.length === 1 ? "" : "s"} with log and page?\n\n${list}`)) return;
    try { for (const id of ids) await callApi("DELETE", `/api/flights/${id}`); } catch (error) { alert(error.message); }
    location.reload();
  });

  // Dropping logs: each is sent in a request of its own, one after the other, so that the list has them in this order.
  const dropArea = $("drop"), uploadList = $("uploads"), uploadItems = new Map();
  let areAllUploadsShown = false;
  // Several files have one line, which counts them and names the one in work; those that could not be read, or were
  // in the library before, are listed below it, and all where somebody asks. The table below has those that are done.
  const summariseUploads = () => {
    const items = [...uploadList.children], isFolded = items.length > 1 && !areAllUploadsShown;
    const count = state => items.filter(item => item.dataset.state === state).length, failed = count("failed"), done = count("done"), known = count("known");
    for (const item of items) item.classList.toggle("hidden", isFolded && !["failed", "known"].includes(item.dataset.state));
    const current = items.find(item => item.dataset.stage === "current") ?? items.find(item => item.dataset.state === "working");
    const now = current ? `, now ${current.firstChild.textContent}` : "", text = `${done} of ${items.length} analysed${known ? `, ${known} already here` : ""}${failed ? `, ${failed} not read` : ""}${now}`;
    $("uploadsummary").hidden = items.length < 2;
    $("uploadprogress").hidden = !current;
    Object.assign($("uploadprogress"), { max: items.length, value: done + known + failed });
    if ($("uploadcount").textContent !== text) $("uploadcount").textContent = text;
    $("showuploads").textContent = areAllUploadsShown ? "Show one line" : "Show all";
  };
  $("showuploads")?.addEventListener("click", () => { areAllUploadsShown = !areAllUploadsShown; summariseUploads(); });
  const setUpload = (item, state, level, text, isCurrent = false) => {
    item.dataset.state = state;
    item.dataset.stage = isCurrent ? "current" : "";
    item.status.className = `said ${level}`;
    item.status.textContent = marks[level] && state !== "working" ? `${marks[level]} ${text}` : text;
    if (state !== "working") item.bar.remove();
    // What is not read stays listed until somebody has seen it.
    if (state === "failed" && !item.querySelector("button")) {
      const close = element("button", "×", item, "plain close");
      Object.assign(close, { type: "button", title: "Remove this line" }).setAttribute("aria-label", `Remove the line of ${item.firstChild.textContent}`);
      close.addEventListener("click", () => { item.remove(); summariseUploads(); });
    }
    summariseUploads();
  };
  const addUploadItem = name => {
    const item = element("li", "", uploadList);
    item.dataset.state = "working";
    element("span", name, item);
    item.bar = element("progress", "", item);
    item.bar.max = 1;
    item.status = element("span", "", item, "said");
    return item;
  };
  const queue = [];
  let isSending = false;
  const send = () => {
    if (!isSending && queue.length) {
      const [file, item] = queue.shift(), request = new XMLHttpRequest(), form = new FormData();
      isSending = true;
      form.append("keep", $("keep").checked ? "true" : "false");
      form.append("filearg", file);
      request.open("POST", "/api/logs");
      if (key) request.setRequestHeader("Authorization", `Bearer ${key}`);
      request.responseType = "json";
      request.upload.onprogress = event => {
        item.bar.value = progressByStage.waiting * event.loaded / event.total;
        item.status.textContent = `Sending ${Math.floor(100 * event.loaded / event.total)} % of ${(event.total / 1e6).toPrecision(3)} MB`;
      };
      request.onloadend = () => {
        isSending = false;
        // A busy server gets the same file again.
        if (request.status === 503) { queue.unshift([file, item]); return void setTimeout(send, 3000); }
        send();
        const content = request.response;
        if (request.status !== 201) {
          setUpload(item, "failed", "bad", content?.error ? `${content.error.reason} ${content.error.remedy}` : "The server does not answer.");
          return;
        }
        // A log that the library has already is done at once: its page would not say so.
        const known = content.flights.filter(flight => flight.stage === "done");
        if (item.isOnlyUpload && !known.length) { location = `/f/${content.flights[0].id}`; return; }
        // Copies of one log are one flight.
        for (const flight of content.flights) uploadItems.set(flight.id, [...uploadItems.get(flight.id) ?? [], item]), showProgress(flight);
        for (const flight of known) setUpload(item, "known", flight.level, `Already here: ${flight.headline}`);
        searchAfter(300);
        watchProgress();
      };
      request.send(form);
    }
  };
  const uploadFiles = files => {
    for (const file of files) {
      const item = addUploadItem(file.name);
      item.isOnlyUpload = files.length === 1;
      item.status.textContent = "Waits to be sent";
      queue.push([file, item]);
    }
    summariseUploads();
    send();
  };
  // The estimated time until a log is read: in seconds up to a minute and a half, then in minutes, then in hours.
  const remainingText = seconds => {
    if (seconds < 5) return ", ready soon";
    if (seconds < 90) return `, ready in about ${5 * Math.round(seconds / 5)} s`;
    const minutes = Math.round(seconds / 60);
    return minutes < 90 ? `, ready in about ${minutes} min` : `, ready in about ${(minutes / 60).toFixed(1)} h`;
  };
  // How far a log is: who comes before it, or the step of the work, its share and the time so far.
  const progressText = flight => {
    const left = flight.estimated_end ? remainingText(flight.estimated_end - Date.now() / 1000) : "";
    // The answer to an upload has no words yet.
    const words = flight.words ?? "Received";
    if (flight.stage === "waiting") {
      // The place in the queue is not known before the first progress.
      const place = flight.ahead === undefined ? "" : flight.ahead ? `, ${flight.ahead} before it` : ", next to be read";
      return words + place + left;
    }
    const share = flight.share === null || flight.share === undefined ? "" : ` ${Math.round(100 * flight.share)} %`;
    const seconds = flight.seconds === null || flight.seconds === undefined ? "" : `, ${flight.seconds} s so far`;
    return `${flight.step || words}${share}${seconds}${left}`;
  };
  const progressByStage = { waiting: 0.1, reading: 0.3, judging: 0.5, learning: 0.6, drawing: 0.8, done: 1, failed: 1 };
  const showProgress = flight => {
    const items = uploadItems.get(flight.id) ?? [], hasFailed = flight.stage === "failed", isOver = hasFailed || flight.stage === "done";
    for (const item of items) {
      item.bar.value = progressByStage[flight.stage];
      const name = item.firstChild;
      if (name.tagName !== "A") {
        const link = element("a", name.textContent, null);
        link.href = `/f/${flight.id}`;
        name.replaceWith(link);
      }
      setUpload(item, hasFailed ? "failed" : isOver ? "done" : "working", hasFailed ? "bad" : flight.level, flight.problem || flight.headline || progressText(flight), !isOver && flight.stage !== "waiting");
    }
    if (isOver && items.length) uploadItems.delete(flight.id), searchAfter(200);
  };
  $("filearg")?.addEventListener("change", event => { uploadFiles(event.target.files); event.target.value = ""; });
  if (dropArea) {
    for (const kind of ["dragenter", "dragover"]) document.addEventListener(kind, event => { event.preventDefault(); dropArea.classList.add("over"); });
    document.addEventListener("dragleave", event => { if (!event.relatedTarget) dropArea.classList.remove("over"); });
    document.addEventListener("drop", event => {
      event.preventDefault();
      dropArea.classList.remove("over");
      uploadFiles(event.dataTransfer.files);
    });
  }
  $("sample")?.addEventListener("click", async () => {
    const log = await (await fetch("/static/sample")).blob();
    uploadFiles([new File([log], "sample_flight.tlog")]);
  });

  // What is being read. The rows of the list show it, also after they came anew.
  const progressById = new Map();
  const showStage = flight => {
    const row = rowOf(flight.id), stageText = row?.querySelector("[data-stage]");
    if (stageText) stageText.textContent = `${progressText(flight)} …`;
    return row;
  };
  let source = null;
  const isHidden = () => document.visibilityState !== "visible";
  const watchProgress = remainingId => {
    const workingFlight = document.querySelector("#reading[data-working]"), id = remainingId || workingFlight?.dataset.id;
    if (source || isHidden() || !(workingFlight || uploadItems.size || document.querySelector(":is(#flights, #problems) [data-working]"))) return;
    source = new EventSource(id ? `/api/progress?id=${id}` : "/api/progress");
    source.onmessage = event => {
      const flights = JSON.parse(event.data);
      if (workingFlight) return updateFlightPage(flights[0]);
      for (const flight of flights) {
        showProgress(flight);
        progressById.set(flight.id, flight);
        const row = showStage(flight);
        if (row && (flight.stage === "done" || flight.stage === "failed")) searchAfter(200);
      }
    };
    // The server ends the stream when all flights are done and compared with the others of their vehicles, whose verdicts
    // that may change too. An upload whose end was not reported is followed by its id.
    source.addEventListener("end", () => {
      stopWatching();
      searchAfter(0);
      if (uploadItems.size) watchProgress([...uploadItems.keys()][0]);
    });
  };
  const stopWatching = () => { source?.close(); source = null; };
  const updateFlightPage = flight => {
    if (flight.stage === "done" || flight.stage === "failed" || flight.has_plots && !$("flight")) return location.reload();
    $("headline").textContent = flight.headline;
    $("headline").className = flight.level;
    showLights($("lamps"), flight.lights);
    $("step").textContent = `${progressText(flight)}. The page opens by itself when it is ready.`;
    let isBefore = true;
    for (const item of $("steps").children) {
      const isCurrent = item.dataset.stage === flight.stage;
      isBefore &&= !isCurrent;
      item.className = isCurrent ? "is" : isBefore ? "was" : "";
    }
  };
  watchProgress();

  // A page that is seen shows what has changed meanwhile, such as verdicts that follow from flights which came after it.
  // Hidden pages ask nothing: a browser has six connections to a server at most, which their streams would take up.
  const LOOK_SECONDS = 10;
  const lookAgain = () => {
    if (isHidden()) return stopWatching();
    watchProgress();
    searchAfter(0);
    followVerdict();
  };
  document.addEventListener("visibilitychange", lookAgain);
  setInterval(lookAgain, 1000 * LOOK_SECONDS);

  // The page of one flight.
  const id = $("bar")?.dataset.id ?? $("reading")?.dataset.id;
  // Its motors are compared with the vehicle's other flights a moment after it was read, and again whenever another flight
  // of the vehicle comes. A verdict that this changes is in the page that the server then sends; what is being typed is
  // not lost. The stream ends at once where nothing is left to compare.
  let comparison = null;
  const followVerdict = () => {
    const shown = $("bar")?.dataset;
    if (comparison || isHidden() || shown?.headline === undefined) return;
    comparison = new EventSource(`/api/progress?id=${id}`);
    let flight = null;
    comparison.onmessage = event => { flight = JSON.parse(event.data)[0]; };
    const stop = () => { comparison.close(); comparison = null; };
    comparison.onerror = stop;
    comparison.addEventListener("end", () => {
      stop();
      const isChanged = flight && (flight.headline !== shown.headline || flight.lights.motors !== shown.motors);
      if (isChanged && !$("edit")?.contains(document.activeElement)) return location.reload();
      if (!isChanged) $("comparing")?.remove();
    });
  };
  if ($("comparing")) followVerdict();
  // What is saved may change the whole page, which is then loaded again, says so, and stays where it was.
  const reloadAfterSaving = statusId => {
    history.replaceState({ statusId, top: scrollY }, "");
    location.reload();
  };
  const saved = history.state;
  if (saved?.statusId && $(saved.statusId)) {
    history.replaceState(null, "");
    const status = $(saved.statusId), part = status.closest("details");
    if (part) part.open = true;
    status.textContent = "Saved.";
    scrollTo(0, saved.top);
  }
  const savedStatus = sessionStorage.getItem("savedStatus");
  sessionStorage.removeItem("savedStatus");
  if (savedStatus && $(savedStatus)) $(savedStatus).textContent = "Saved.";
  let savedSharing = $("sharing")?.value;
  $("edit")?.addEventListener("submit", async event => {
    event.preventDefault();
    const form = event.target.elements;
    const columns = { given_name: form.given_name?.value, sharing: form.sharing.value, log_shared: form.log_shared.checked, note: form.note.value };
    const isVehicleChanged = form.flight_vehicle && form.flight_vehicle.value !== form.flight_vehicle.defaultValue;
    if (isVehicleChanged) columns.vehicle_name = form.flight_vehicle.value;
    const isRepairChanged = form.repaired && form.repaired.checked !== form.repaired.defaultChecked;
    if (isRepairChanged) columns.repaired = form.repaired.checked;
    columns.tags = form.tags.value.split(",").map(tag => tag.trim()).filter(Boolean);
    try { await callApi("PATCH", `/api/flights/${id}`, columns); savedSharing = columns.sharing; if (isVehicleChanged || isRepairChanged || form.given_name && form.given_name.value !== form.given_name.defaultValue) return reloadAfterSaving("saved"); $("saved").textContent = "Saved."; } catch (error) { $("saved").textContent = error.message; }
  });
  // The flights of unnamed vehicles that are chosen get the name of their vehicle, one request each.
  $("assign")?.addEventListener("click", async () => {
    const name = $("assigned_name").value;
    try {
      let vehicle = "";
      for (const flight of chosenIds()) ({ vehicle } = await callApi("PATCH", `/api/flights/${flight}`, { vehicle_name: name }));
      // The page of the vehicle says that it is saved.
      sessionStorage.setItem("savedStatus", "named");
      location = `/vehicle?${new URLSearchParams({ name: vehicle })}`;
    } catch (error) { $("assigned").textContent = error.message; }
  });
  $("naming")?.addEventListener("submit", async event => {
    event.preventDefault();
    const vehicle = event.target.dataset.vehicle, name = $("vehicle_name").value;
    try { await callApi("PUT", "/api/vehicle", { vehicle, name }); reloadAfterSaving("named"); } catch (error) { $("named").textContent = error.message; }
  });
  $("copy")?.addEventListener("click", async () => {
    $("address").select();
    try { await navigator.clipboard.writeText($("address").value); } catch { document.execCommand("copy"); }
    const isForOwner = $("bar").dataset.guarded != null && savedSharing === "private";
    $("copied").textContent = isForOwner ? "Copied. Nobody else can open it while the flight is seen by you only: choose who sees it above, and save." : "Copied.";
  });
  $("delete")?.addEventListener("click", async () => {
    if (!confirm(`Delete ${document.querySelector("h1").textContent} with log and page?`)) return;
    try { await callApi("DELETE", `/api/flights/${id}`); location = "/"; } catch (error) { alert(error.message); }
  });
  // Recordings are made when somebody asks for them. Meanwhile the page shows how far they are.
  const makeRecordings = async () => {
    const path = `/api/flights/${id}/recordings`, status = $("making"), began = Date.now();
    let state = await callApi("POST", path);
    while (state.stage !== "done") {
      if (state.stage === "failed") throw new Error(state.problem);
      status.className = "soft";
      status.textContent = `${state.words} … ${Math.round((Date.now() - began) / 1000)} s`;
      await new Promise(resolve => setTimeout(resolve, 500));
      state = await callApi("GET", path);
    }
    for (const link of document.querySelectorAll("#bar [data-missing]")) link.removeAttribute("data-missing");
    status.textContent = "";
  };
  const showRecordingProblem = error => {
    $("making").className = "said bad";
    $("making").textContent = error.message;
  };
  for (const link of document.querySelectorAll("#bar [data-missing]")) link.addEventListener("click", async event => {
    if (!link.hasAttribute("data-missing")) return;
    event.preventDefault();
    try { await makeRecordings(); location = link.href; } catch (error) { showRecordingProblem(error); }
  });
  // The page with Rerun's viewer: while somebody looks at it, the viewer stays open; one that has ended is started again.
  const viewerCanvas = $("viewer"), VIEWER_SECONDS = 30;
  // One request and one timer at a time, however often the page gets the focus.
  let viewerTimer = 0, isAskingForViewer = false;
  const keepViewerOpen = async () => {
    if (isAskingForViewer) return;
    isAskingForViewer = true;
    clearTimeout(viewerTimer);
    try {
      const viewer = await callApi("POST", `/api/flights/${viewerCanvas.dataset.id}/viewer`);
      if (viewer.data_address) showInRerun(viewer.data_address);
      else {
        $("viewer_status").textContent = `${viewer.words} …`;
        viewerTimer = setTimeout(keepViewerOpen, 1000);
      }
    } catch (error) { $("viewer_status").textContent = error.message; }
    isAskingForViewer = false;
  };
  if (viewerCanvas?.dataset.id) {
    const keepOpenIfSeen = () => { if (document.visibilityState === "visible" && document.hasFocus()) keepViewerOpen(); };
    keepViewerOpen();
    setInterval(keepOpenIfSeen, 1000 * VIEWER_SECONDS);
    for (const kind of ["focus", "pointerover"]) addEventListener(kind, keepOpenIfSeen);
    document.addEventListener("visibilitychange", keepOpenIfSeen);
  }
  $("rerun")?.addEventListener("click", async () => {
    const button = $("rerun"), path = `/api/flights/${id}/viewer`;
    button.disabled = true;
    try {
      const viewer = await callApi("POST", path);
      if (!viewer.address) await makeRecordings();
      // A browser may block a window that opens long after the click.
      const page = `/f/${id}/viewer`;
      if (!open(page, "_blank")) {
        const link = element("a", "The recording is ready: open it", null);
        link.href = page;
        link.target = "_blank";
        $("making").replaceChildren(link);
      }
    } catch (error) { showRecordingProblem(error); }
    button.disabled = false;
  });

  // Any field of the log: a list that is searched, and plots of the fields that are chosen below the others. With Shift a
  // field joins the last of these plots. What is plotted stands in the address, so that a link shows it too.
  const fieldsPart = $("fields"), plots = document.documentElement.charts, column = document.querySelector("#flight .charts .column");
  const vehicle = new URL(location).searchParams.get("vehicle") ?? "";
  const fieldColours = ["#1f7ad6", "#12997a", "#b5852a", "#9461d1", "#c2477f"];
  const fieldPlots = [];
  let listedMessages = null;
  const fieldName = ({ message, field, instance }) => `${message}${instance == null ? "" : `[${instance}]`}.${field}`;
  const plotOf = wanted => fieldPlots.find(plot => plot.wanted.some(one => fieldName(one) === fieldName(wanted)));
  const keepPlotsInAddress = () => {
    const address = new URL(location);
    address.searchParams.delete("plot");
    for (const { wanted } of fieldPlots) address.searchParams.append("plot", wanted.map(({ message, instance, field }) => [message, instance ?? "", field].join("~")).join("|"));
    history.replaceState(null, "", address);
  };
  const unitOf = ({ message, field }) => {
    const listed = listedMessages?.find(({ shown }) => shown === message);
    return listed?.units[listed.fields.indexOf(field)] ?? "";
  };
  const nameWithUnit = wanted => unitOf(wanted) ? `${fieldName(wanted)} (${unitOf(wanted)})` : fieldName(wanted);
  const fetchSamples = (wanted, [start, end]) => {
    const query = new URLSearchParams({ message: wanted.message, field: wanted.field, boot: fieldsPart.dataset.boot, start, end, vehicle });
    if (wanted.instance != null) query.set("instance", wanted.instance);
    return callApi("GET", `/api/flights/${id}/samples?${query}`);
  };
  // The samples of the fields of one plot, as its lines.
  const fetchLines = (wanted, span, colours) => Promise.all(wanted.map(async (one, i) => {
    const { time, values, is_thinned: isThinned, count } = await fetchSamples(one, span);
    return { name: nameWithUnit(one), colour: colours[i], times: time, values, isThinned, count };
  }));
  const removePlot = plot => {
    plot.chart.remove();
    fieldPlots.splice(fieldPlots.indexOf(plot), 1);
  };
  // Plots fields in one plot below the others, or, if they are added, in the last of the plots of fields.
  const plotFields = async (fields, isAdded = false) => {
    const newFields = fields.filter(one => !plotOf(one)), status = $("fieldstatus"), last = isAdded ? fieldPlots.at(-1) : null;
    if (!newFields.length) { plotOf(fields[0]).chart.figure.scrollIntoView({ block: "nearest" }); return; }
    const wanted = [...last?.wanted ?? [], ...newFields], newNames = newFields.map(fieldName).join(", ");
    const colours = wanted.map((_, i) => fieldColours[((last ? fieldPlots.length - 1 : fieldPlots.length) + i) % fieldColours.length]);
    status.textContent = `Reading ${newNames} …`;
    try {
      const group = plots.groups.flight, lines = await fetchLines(wanted, group.whole, colours), newLines = lines.slice(-newFields.length);
      if (newFields.some(plotOf) || last && !fieldPlots.includes(last)) return;
      if (newLines.every(({ values }) => values.every(value => value == null))) { status.textContent = `${newNames} has no values in this flight.`; return; }
      if (last) removePlot(last);
      const title = lines.map(({ name }) => name).join(", "), chart = plots.addLines(column, title, lines);
      const plot = { chart, wanted, colours, isThinned: lines.some(({ isThinned }) => isThinned), span: String(group.whole) };
      const close = element("button", "×", chart.header, "plain close");
      Object.assign(close, { type: "button", title: "Remove this plot" }).setAttribute("aria-label", `Remove the plot of ${title}`);
      close.addEventListener("click", () => { removePlot(plot); keepPlotsInAddress(); showFields(); });
      fieldPlots.push(plot);
      status.textContent = `${newNames}: ${newLines[0].count} samples, below the other plots.`;
      keepPlotsInAddress();
      showFields();
    } catch (error) { status.textContent = error.message; }
  };
  // A zoomed plot that was thinned gets the samples of what is shown.
  let zoomTimer;
  document.documentElement.addEventListener("zoomed", ({ detail: group }) => {
    if (group !== plots?.groups.flight) return;
    clearTimeout(zoomTimer);
    zoomTimer = setTimeout(async () => {
      for (const plot of [...fieldPlots]) {
        const span = String(group.span);
        if (!plot.isThinned || plot.span === span) continue;
        plot.span = span;
        try {
          const lines = await fetchLines(plot.wanted, group.span, plot.colours);
          if (plot.span === span && lines.some(({ times }) => times.length)) plot.chart.replace(lines);
        } catch { /* What is shown stays. */ }
      }
    }, 250);
  });
  const MAX_SHOWN_FIELDS = 60;
  const wordsOfName = name => name.toLowerCase().split(/[^a-z0-9]+/).filter(Boolean);
  // Plain words for the short names of ArduPilot's messages and fields, by which they are found as well.
  const plainMessages = {
    ATT: "attitude", BARO: "barometer", BAT: "battery", CTUN: "height throttle", CURR: "battery", GPS: "position", GYR: "gyro", IMU: "gyro accelerometer",
    MAG: "compass", PIDP: "rate pitch", PIDR: "rate roll", PIDY: "rate yaw", POS: "position", RATE: "rate", RCIN: "radio input", RCOU: "motor output",
    VIBE: "vibration",
  };
  const plainFields = {
    BAT: { Volt: "voltage", Curr: "current" }, CURR: { Volt: "voltage", Curr: "current" },
    RATE: { R: "roll", RDes: "roll setpoint", P: "pitch", PDes: "pitch setpoint", Y: "yaw", YDes: "yaw setpoint" },
    GPS: { Lat: "latitude", Lng: "longitude", Alt: "height" }, POS: { Lat: "latitude", Lng: "longitude", Alt: "height" },
  };
  // What is plotted first of a message: voltages, rates, outputs, positions. And what describes the others, which comes last.
  const isMainField = field => /^(volt|roll|r$|x$|gyr|output|controls?\b|c1$|lat|rms|press)/i.test(field);
  const describingWords = new Set(["clipping", "connected", "count", "dt", "flags", "healthy", "id", "inst", "instance", "noutputs", "priority", "samples", "valid", "warning"]);
  // The elements of arrays, such as "gyro[0]", by the array's name.
  const elementsOf = fields => {
    const arrays = new Map();
    for (const field of fields) {
      const name = /^(.*)\[\d+\]$/.exec(field)?.[1];
      if (name) arrays.set(name, [...arrays.get(name) ?? [], field]);
    }
    return [...arrays].filter(([, elements]) => elements.length > 1);
  };
  // Without a search the messages are listed, of which one is chosen; with one the fields that have all its words.
  const showFields = () => {
    if (!listedMessages) return;
    const list = $("fieldlist"), words = $("fieldsearch").value.toLowerCase().split(/\s+/).filter(Boolean);
    list.replaceChildren();
    const add = (text, note, action, isPressed) => {
      const button = element("button", "", element("li", "", list)), name = element("span", "", button);
      button.type = "button";
      // A long name is broken after a full stop or an underscore only.
      for (const part of text.split(/(?<=[._])/)) name.append(part, document.createElement("wbr"));
      if (note) element("span", note, button, "soft");
      if (isPressed != null) button.setAttribute("aria-pressed", isPressed);
      button.addEventListener("click", action);
    };
    if (!words.length) {
      for (const message of listedMessages) {
        add(message.shown, `${message.fields.length} fields`, () => { $("fieldsearch").value = `${message.shown}.`; showFields(); $("fieldsearch").focus(); });
      }
      return;
    }
    const found = [], searchedWords = words.flatMap(wordsOfName);
    // Times come last: nobody plots a clock over time. Before them come fields that only describe others, such as how many
    // there are. Messages that are named by a searched word come first, and of each the scalars before the arrays, what is
    // mostly looked at, and the name with the fewest words that are not searched for.
    const rankOf = (message, field) => {
      const fieldWords = wordsOfName(field.replace(/\[.*/, "")), isTime = /^time|timestamp|^t$/i.test(field);
      const fieldAndPlain = `${field} ${plainFields[message.shown]?.[field] ?? ""}`.toLowerCase();
      const hasSearchedWord = searchedWords.some(word => fieldAndPlain.includes(word));
      const extraWords = [...wordsOfName(message.shown), ...fieldWords].filter(word => !searchedWords.some(one => word.includes(one)));
      const isDescribing = fieldWords.some(word => describingWords.has(word));
      const messageName = `${message.shown} ${plainMessages[message.shown] ?? ""}`.toLowerCase();
      const isNamed = searchedWords.some(word => messageName.includes(word));
      return [isTime, isDescribing, !isNamed, !hasSearchedWord, field.includes("["), !isMainField(field), extraWords.length];
    };
    const noteOn = (message, field) => [unitOf({ message: message.shown, field }), message.rate && `${Number(message.rate.toPrecision(2))} Hz`].filter(Boolean).join(", ");
    for (const message of listedMessages) {
      for (const instance of message.instances.length > 1 ? message.instances : [null]) for (const [field, fields] of [...elementsOf(message.fields).map(([array, elements]) => [`${array}[all ${elements.length}]`, elements]), ...message.fields.map(field => [field, [field]])]) {
        const wanted = fields.map(one => ({ message: message.shown, field: one, instance }));
        const name = fieldName({ message: message.shown, field, instance }), plain = `${plainMessages[message.shown] ?? ""} ${plainFields[message.shown]?.[field] ?? ""}`;
        const searched = `${name} ${message.message}.${field} ${plain}`.toLowerCase();
        if (!words.every(word => searched.includes(word)) && !(words.length === 1 && `${message.shown}.${field}`.toLowerCase().startsWith(words[0]))) continue;
        found.push({ name, wanted, note: noteOn(message, fields[0]), rank: rankOf(message, field) });
      }
    }
    found.sort((a, b) => {
      const different = a.rank.findIndex((value, i) => value !== b.rank[i]);
      return different < 0 ? 0 : a.rank[different] - b.rank[different];
    });
    for (const { name, wanted, note } of found.slice(0, MAX_SHOWN_FIELDS)) add(name, note, event => plotFields(wanted, event.shiftKey), wanted.every(plotOf));
    if (found.length > MAX_SHOWN_FIELDS) element("li", `and ${found.length - MAX_SHOWN_FIELDS} more: add a word`, list, "soft");
    if (!found.length) element("li", "No field has all these words.", list, "soft");
  };
  // An Enter that came while the log was read counts once it is read.
  let isEnterWaiting = null;
  const plotFirstField = isAdded => {
    isEnterWaiting = null;
    const button = $("fieldlist").querySelector("button[aria-pressed=false]");
    button?.dispatchEvent(new MouseEvent("click", { shiftKey: isAdded }));
  };
  const listFields = async () => {
    if (listedMessages) return;
    const status = $("fieldstatus");
    status.textContent = "Reading the log …";
    try {
      const { messages } = await callApi("GET", `/api/flights/${id}/fields?${new URLSearchParams({ vehicle })}`);
      listedMessages = messages.map(message => ({ ...message, shown: message.name_in_source.split("/")[0] }));
      // Of messages that the log calls by one name, each is called as MAVLink calls it.
      const counts = new Map();
      for (const { shown } of listedMessages) counts.set(shown, (counts.get(shown) ?? 0) + 1);
      for (const message of listedMessages) if (counts.get(message.shown) > 1) message.shown = message.message;
      listedMessages.sort((a, b) => a.shown.localeCompare(b.shown));
      status.textContent = `${messages.length} messages. Choose a field, and it is plotted with the others; with Shift, in the last plot.`;
      showFields();
      if (isEnterWaiting) plotFirstField(isEnterWaiting.shiftKey);
    } catch (error) { status.textContent = error.message; }
  };
  // A page that an earlier version wrote has no plots that others can be added to.
  if (fieldsPart && plots?.addLines && column && $("bar")) {
    const details = element("details", "", null, "fields"), label = element("label", "Search ", null), input = element("input", "", label);
    const summary = element("summary", "Plot any field of the log", details);
    // The cursor is in the box as soon as that is open, so that no letter is lost.
    summary.addEventListener("click", () => requestAnimationFrame(() => { if (details.open) input.focus(); }));
    Object.assign(input, { id: "fieldsearch", type: "search", placeholder: "words of message and field", autocomplete: "off" });
    const status = element("p", "", null, "soft"), list = element("ul", "", null, "fieldlist");
    Object.assign(status, { id: "fieldstatus" }).setAttribute("role", "status");
    list.id = "fieldlist";
    details.append(label, status, list);
    fieldsPart.replaceChildren(details);
    // An Enter is of the words before it: it does not count for those that are typed later.
    input.addEventListener("input", () => {
      if (isEnterWaiting) status.textContent = "Reading the log …";
      isEnterWaiting = null;
      showFields();
    });
    // Enter plots the first field that is found, so that no hand leaves the keyboard.
    input.addEventListener("keydown", event => {
      if (event.key !== "Enter") return;
      event.preventDefault();
      if (listedMessages) return plotFirstField(event.shiftKey);
      isEnterWaiting = event;
      status.textContent = "Reading the log; then the first field that is found is plotted …";
    });
    details.addEventListener("toggle", () => { if (details.open) listFields(); });
    const plotted = new URL(location).searchParams.getAll("plot").map(text => text.split("|").map(part => part.split("~")).filter(parts => parts.length === 3)).filter(fields => fields.length);
    const plotThose = async () => {
      // The list has the units.
      details.open = true;
      await listFields();
      for (const fields of plotted) await plotFields(fields.map(([message, instance, field]) => ({ message, field, instance: instance ? Number(instance) : null })));
    };
    if (plotted.length) {
      if (plots.groups.flight) plotThose(); else document.documentElement.addEventListener("drawn", plotThose, { once: true });
    }
  }

  // Parameters that differ from the vehicle's flight before are marked when somebody looks at them: its page has them all.
  const parameters = $("parameters-table"), bar = $("bar")?.dataset ?? {};
  const valuesOf = table => new Map([...table?.tBodies[0].rows ?? []].map(row => [row.cells[0].textContent, row.cells[1].textContent]));
  const markParameters = async () => {
    const status = $("parameterstatus"), flight = `${bar.previousName} (${bar.previousDate})`;
    try {
      const response = await fetch(`/f/${bar.previous}`, { headers });
      if (!response.ok) throw new Error(`The flight before, ${flight}, cannot be read.`);
      const page = new DOMParser().parseFromString(await response.text(), "text/html"), before = valuesOf(page.getElementById("parameters-table"));
      if (!before.size) throw new Error(`The flight before, ${flight}, lists no parameters.`);
      const selfSet = new RegExp(bar.selfSet);
      let set = 0, learned = 0;
      for (const row of parameters.tBodies[0].rows) {
        const [name, value, remark] = [...row.cells].map(cell => cell.textContent);
        if (before.get(name) === value) continue;
        const isLearned = selfSet.test(name), text = before.has(name) ? `last flight ${before.get(name)}` : "not in the last flight";
        if (isLearned) learned += 1; else set += 1;
        row.cells[2].textContent = [remark, isLearned ? `${text}, set by the autopilot` : text].filter(Boolean).join("; ");
        if (!isLearned) row.cells[2].className = "watch";
        row.dataset.differs = isLearned ? "learned" : "set";
      }
      const now = valuesOf(parameters), gone = [...before.keys()].filter(name => !now.has(name));
      const count = set === 0 ? "No setting differs" : set === 1 ? "1 setting differs" : `${set} settings differ`, listed = gone.length > 5 ? `${gone.slice(0, 5).join(", ")}, …` : gone.join(", ");
      status.textContent = `${count} from the last flight, ${flight}${learned ? `; of what the autopilot sets by itself ${learned} do` : ""}.${gone.length ? ` Not here any more: ${listed} (${gone.length}).` : ""}`;
      if (!set && !learned) return;
      const button = element("button", "Show those alone", null, "plain");
      button.type = "button";
      button.setAttribute("aria-pressed", "false");
      button.addEventListener("click", () => {
        const isAlone = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", isAlone);
        button.textContent = isAlone ? "Show all" : "Show those alone";
        for (const row of parameters.tBodies[0].rows) row.classList.toggle("hidden", isAlone && !row.dataset.differs);
      });
      status.append(" ", button);
    } catch (error) { status.textContent = error.message; }
  };
  if (parameters && bar.previous) {
    const part = parameters.closest("details"), status = element("p", "", null, "soft");
    Object.assign(status, { id: "parameterstatus" }).setAttribute("role", "status");
    parameters.parentElement.before(status);
    const mark = () => {
      if (!part.open || status.textContent) return;
      status.textContent = `Comparing with the last flight, ${bar.previousName} …`;
      markParameters();
    };
    part.addEventListener("toggle", mark);
    mark();
  }
})();
