// Runs Rerun's viewer in the page, from the files of the viewer that runs on this machine; nothing comes from elsewhere.
(() => {
  // Pixels of width from which the panels of a dashboard stand beside each other and can be read.
  const MIN_WIDTH = 900, BYTES_PER_MEGABYTE = 1e6, CRASH_CHECK_MILLISECONDS = 1000;
  const canvas = document.getElementById("viewer"), status = document.getElementById("viewer_status"), narrow = document.getElementById("narrow");
  const tell = (text, isProblem = false) => {
    status.textContent = text;
    status.classList.toggle("bad", isProblem);
  };
  const loadScript = address => new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = address;
    script.onload = resolve;
    script.onerror = () => reject(new Error("mavdem does not answer"));
    document.head.append(script);
  });
  // Returns the response with the program, and says meanwhile how much of it has come.
  const loadProgram = async address => {
    const response = await fetch(address);
    if (!response.ok) throw new Error(await response.text());
    const megabytes = bytes => Math.round(bytes / BYTES_PER_MEGABYTE), total = megabytes(response.headers.get("Content-Length"));
    let bytes = 0;
    const counted = response.body.pipeThrough(new TransformStream({
      transform(chunk, controller) {
        bytes += chunk.byteLength;
        tell(`Loading the dashboard: ${megabytes(bytes)} of ${total} MB`);
        controller.enqueue(chunk);
      },
    }));
    return new Response(counted, { headers: { "Content-Type": "application/wasm" } });
  };
  const start = async address => {
    tell("Loading the dashboard");
    await loadScript("/rerun/re_viewer.js");
    await wasm_bindgen({ module_or_path: await loadProgram("/rerun/re_viewer_bg.wasm") });
    tell("Starting the dashboard");
    // Rerun tries to send statistics of its use, which the policy of this page forbids. The colours of the lines are for a
    // dark background.
    const viewer = new wasm_bindgen.WebHandle({ url: [address], hide_welcome_screen: true, enable_history: false, persist: false, theme: "dark" });
    await viewer.start(canvas);
    tell("");
    const timer = setInterval(() => {
      if (!viewer.has_panicked()) return;
      clearInterval(timer);
      canvas.remove();
      tell(`Rerun's viewer has failed; load this page again. ${viewer.panic_message()}`, true);
    }, CRASH_CHECK_MILLISECONDS);
  };

  let shownAddress = "";
  // Shows what a server of Rerun has at an address such as rerun+http://127.0.0.1:9876/proxy.
  const showInRerun = address => {
    if (address === shownAddress) return;
    // A viewer that has been started again has another address.
    if (shownAddress) return location.reload();
    shownAddress = address;
    const begin = () => start(address).catch(error => tell(`The dashboard cannot be shown: ${error.message ?? error}. It needs a browser of 2023 or newer with WebGL.`, true));
    if (innerWidth >= MIN_WIDTH) return begin();
    narrow.hidden = false;
    document.getElementById("show_anyway").addEventListener("click", () => {
      narrow.hidden = true;
      begin();
    });
  };
  window.showInRerun = showInRerun;

  // The headline of a live session stands above its dashboard, which itself looks the same whether data come or not.
  const followSession = () => {
    const headline = document.getElementById("session_headline"), silence = document.getElementById("silence"), { updates } = document.documentElement;
    let tag = "";
    const take = answer => {
      silence.hidden = answer.age < updates.LONGEST_PAUSE; // a refusal has no age
      if (!answer.text) return tag;
      ({ tag } = answer);
      const page = new DOMParser().parseFromString(answer.text, "text/html");
      document.title = page.title;
      headline.textContent = page.querySelector("#result .headline").textContent;
      headline.classList.toggle("bad", page.getElementById("result").classList.contains("doubted"));
      // As in live.js: the last page of a session has no level of now, and nothing follows it.
      if (page.querySelector("main").dataset.level !== undefined) return tag;
      tell("The session is over.");
      return null;
    };
    updates.follow("/live", take, () => { silence.hidden = false; });
  };
  if (canvas.dataset.address) {
    showInRerun(canvas.dataset.address);
    followSession();
  }
})();
