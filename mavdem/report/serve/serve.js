"use strict";
(() => {
  const $ = id => document.getElementById(id);
  const key = document.querySelector('meta[name="mavdem-key"]')?.content || "";
  const headers = key ? { Authorization: `Bearer ${key}` } : {};
  const ask = async (method, path, body) => {
    const given = { method, headers: { ...headers } };
    if (body !== undefined) {
      given.body = JSON.stringify(body);
      given.headers["Content-Type"] = "application/json";
    }
    const answer = await fetch(path, given), said = answer.status === 204 ? {} : await answer.json();
    if (!answer.ok) throw new Error([said.error?.reason, said.error?.remedy].filter(Boolean).join(" ") || answer.statusText);
    return said;
  };
  const marks = { good: "●", watch: "▲", bad: "■", unknown: "–" };
  const element = (name, text, parent, cls) => {
    const made = document.createElement(name);
    made.textContent = text;
    if (cls) made.className = cls;
    parent?.append(made);
    return made;
  };
  const lamps = (place, lights) => {
    place.replaceChildren();
    for (const [name, level] of Object.entries(lights)) element("span", `${marks[level]} ${name}`, place, level);
  };

  // The table of flights: search as one types, choice, and what is being read.
  const find = $("find"), rows = () => $("flights")?.tBodies[0];
  const chosen = () => [...document.querySelectorAll('#flights input[name="id"]:checked')].map(box => box.value);
  const choose = () => {
    const count = chosen().length;
    const unread = document.querySelector("#flights input[data-unread]:checked");
    if ($("compare")) $("compare").disabled = count !== 2 || unread;
    if ($("baseline")) $("baseline").disabled = !count || unread;
    if ($("remove")) $("remove").disabled = !count;
  };
  document.addEventListener("change", event => { if (event.target.name === "id") choose(); });
  choose();
  let latest = 0;
  const search = async () => {
    if (!rows()) return;
    const mine = ++latest, query = find.elements.q?.value ?? "", here = new URL(location);
    if (query) here.searchParams.set("q", query); else here.searchParams.delete("q");
    if (query !== shownQuery) here.searchParams.delete("offset");
    const answer = await fetch(here, { headers });
    if (!answer.ok || mine !== latest) return;
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const list = page.getElementById("flights");
    if (!list) return;
    const kept = new Set(chosen());
    rows().replaceChildren(...list.tBodies[0].rows);
    for (const box of document.querySelectorAll('#flights input[name="id"]')) box.checked = kept.has(box.value);
    if ($("count")) $("count").textContent = page.getElementById("count").textContent;
    if (query !== shownQuery) history.replaceState(null, "", here);
    shownQuery = query;
    choose();
    watch();
  };
  let shownQuery = find?.elements.q?.value ?? "", timer;
  const soon = wait => { clearTimeout(timer); timer = setTimeout(search, wait); };
  find?.elements.q?.addEventListener("input", () => soon(150));
  find?.addEventListener("submit", event => { event.preventDefault(); soon(0); });
  $("compare")?.addEventListener("click", () => {
    const [b, a] = chosen();
    location = `/compare?a=${a}&b=${b}`;
  });
  $("baseline")?.addEventListener("click", async () => {
    try { await ask("PUT", "/api/baseline", { flights: chosen() }); location.reload(); } catch (error) { alert(error.message); }
  });
  $("remove")?.addEventListener("click", async () => {
    const ids = chosen();
    if (!confirm(`Delete ${ids.length} flight${ids.length === 1 ? "" : "s"} with log and page?`)) return;
    try { for (const id of ids) await ask("DELETE", `/api/flights/${id}`); } catch (error) { alert(error.message); }
    location.reload();
  });

  // Dropping logs: three are sent at a time, each in a request of its own.
  const drop = $("drop"), list = $("uploads"), lines = new Map();
  const line = name => {
    const item = element("li", "", list);
    element("span", name, item);
    item.bar = element("progress", "", item);
    item.bar.max = 1;
    item.said = element("span", "", item, "said");
    return item;
  };
  const queue = [];
  let sending = 0;
  const send = () => {
    while (sending < 3 && queue.length) {
      const [file, item] = queue.shift(), request = new XMLHttpRequest(), form = new FormData();
      sending += 1;
      form.append("keep", $("keep").checked ? "true" : "false");
      form.append("filearg", file);
      request.open("POST", "/api/logs");
      if (key) request.setRequestHeader("Authorization", `Bearer ${key}`);
      request.responseType = "json";
      request.upload.onprogress = event => { item.bar.value = 0.3 * event.loaded / event.total; };
      request.onloadend = () => {
        sending -= 1;
        send();
        const said = request.response;
        if (request.status !== 201) {
          if (request.status === 503) { queue.push([file, item]); return void setTimeout(send, 3000); }
          item.bar.remove();
          item.said.className = "said bad";
          item.said.textContent = said?.error ? `${said.error.reason} ${said.error.remedy}` : "The server does not answer.";
          return;
        }
        if (item.alone) { location = `/f/${said.flights[0].id}`; return; }
        for (const flight of said.flights) lines.set(flight.id, item), tell(flight);
        soon(300);
        watch();
      };
      request.send(form);
    }
  };
  const take = files => {
    for (const file of files) {
      const item = line(file.name);
      item.alone = files.length === 1;
      queue.push([file, item]);
    }
    send();
  };
  const shares = { waiting: 0.3, reading: 0.4, judging: 0.5, learning: 0.6, drawing: 0.8, done: 1, failed: 1 };
  const tell = flight => {
    const item = lines.get(flight.id);
    if (!item) return;
    item.bar.value = shares[flight.stage];
    const name = item.firstChild;
    if (name.tagName !== "A") {
      const link = element("a", name.textContent, null);
      link.href = `/f/${flight.id}`;
      name.replaceWith(link);
    }
    item.said.className = `said ${flight.stage === "failed" ? "bad" : flight.level}`;
    item.said.textContent = flight.problem || flight.headline || flight.words;
    if (flight.stage === "done" || flight.stage === "failed") lines.delete(flight.id), item.bar.remove(), soon(200);
  };
  $("filearg")?.addEventListener("change", event => { take(event.target.files); event.target.value = ""; });
  if (drop) {
    for (const kind of ["dragenter", "dragover"]) document.addEventListener(kind, event => { event.preventDefault(); drop.classList.add("over"); });
    document.addEventListener("dragleave", event => { if (!event.relatedTarget) drop.classList.remove("over"); });
    document.addEventListener("drop", event => {
      event.preventDefault();
      drop.classList.remove("over");
      take(event.dataTransfer.files);
    });
  }
  $("sample")?.addEventListener("click", async () => {
    const log = await (await fetch("/static/sample")).blob();
    take([new File([log], "sample_flight.tlog")]);
  });

  // What is being read.
  let source = null;
  const watch = left => {
    const one = document.querySelector("#flight[data-working]"), id = left || one?.dataset.id;
    if (source || !(one || lines.size || document.querySelector("#flights [data-working]"))) return;
    source = new EventSource(id ? `/api/progress?id=${id}` : "/api/progress");
    source.onmessage = event => {
      const flights = JSON.parse(event.data);
      if (one) return follow(flights[0]);
      for (const flight of flights) {
        tell(flight);
        const row = rows()?.querySelector(`tr[data-id="${flight.id}"]`), place = row?.querySelector("[data-stage]");
        if (place) place.textContent = `${flight.words} …`;
        if (row && flight.stage === "done" || flight.stage === "failed") soon(200);
      }
    };
    // What was done between two looks of the server is asked for by itself.
    source.addEventListener("end", () => { source.close(); source = null; if (lines.size) watch([...lines.keys()][0]); });
  };
  const follow = flight => {
    if (flight.stage === "done" || flight.stage === "failed") return location.reload();
    $("headline").textContent = flight.headline;
    $("headline").className = flight.level;
    lamps($("lamps"), flight.lights);
    let before = true;
    for (const item of $("steps").children) {
      const is = item.dataset.stage === flight.stage;
      before &&= !is;
      item.className = is ? "is" : before ? "was" : "";
    }
  };
  watch();

  // The page of one flight.
  const id = $("bar")?.dataset.id ?? $("flight")?.dataset.id;
  $("edit")?.addEventListener("submit", async event => {
    event.preventDefault();
    const form = event.target.elements;
    const columns = { sharing: form.sharing.value, log_shared: form.log_shared.checked, note: form.note.value };
    columns.tags = form.tags.value.split(",").map(tag => tag.trim()).filter(Boolean);
    try { await ask("PATCH", `/api/flights/${id}`, columns); $("saved").textContent = "Saved."; } catch (error) { $("saved").textContent = error.message; }
  });
  $("copy")?.addEventListener("click", async () => {
    $("address").select();
    try { await navigator.clipboard.writeText($("address").value); } catch { document.execCommand("copy"); }
    $("copy").textContent = "Copied";
  });
  $("delete")?.addEventListener("click", async () => {
    if (!confirm("Delete this flight with log and page?")) return;
    try { await ask("DELETE", `/api/flights/${id}`); location = "/"; } catch (error) { alert(error.message); }
  });
  $("rerun")?.addEventListener("click", async () => {
    const button = $("rerun");
    button.disabled = true;
    try { open((await ask("POST", `/api/flights/${id}/viewer`)).address, "_blank"); } catch (error) { alert(error.message); }
    button.disabled = false;
  });
})();
