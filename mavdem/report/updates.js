"use strict";
// Follows a session of the server: asks for its next state again and again. The answer comes as soon as there is one, and
// otherwise after two seconds. The root element has this for the scripts of pages, as "updates".
(() => {
  // Milliseconds until an answer is given up, and from a failure to the next request.
  const PATIENCE = 8000, RETRY = 1000;
  // Seconds with answers that have nothing new after which a page says so: the server makes a new state every five.
  const LONGEST_PAUSE = 15;
  // An answer has the state as text, empty where there is no new one, its tag, and its age, s; or why there is none.
  const ask = async (address, tag) => {
    const headers = tag ? { "If-None-Match": tag } : {};
    const response = await fetch(`${address}/update`, { cache: "no-store", signal: AbortSignal.timeout(PATIENCE), headers });
    const text = await response.text();
    if (!response.ok && response.status !== 304) return { refusal: text || response.statusText };
    return { text: response.ok ? text : "", tag: response.headers.get("ETag"), age: +response.headers.get("Age") };
  };
  // "take" gets each answer, and returns the tag of the state that is shown then, or null where no other is to be asked
  // for; "miss" is told where none comes. After that, and after a refusal, it is not asked at once again.
  const follow = async (address, take, miss) => {
    let tag = "";
    while (tag !== null) {
      let isRefused = true;
      try {
        const answer = await ask(address, tag);
        isRefused = !!answer.refusal;
        tag = take(answer);
      } catch { miss(); }
      if (isRefused) await new Promise(resolve => setTimeout(resolve, RETRY));
    }
  };
  document.documentElement.updates = { follow, LONGEST_PAUSE };
})();
