"use strict";
// Follows a session of the server: asks for its next state again and again. The answer comes as soon as there is one, and
// otherwise after two seconds. The root element has this for the scripts of pages, as "updates".
(() => {
  // Milliseconds until an answer is given up, and from a failure to the next request; of a page whose session is over, for
  // which a server may start again much later, the latter is longer.
  const PATIENCE = 8000, RETRY = 1000, RETRY_AFTER_END = 5000;
  // Seconds with answers that have nothing new after which a page says so: the server makes a new state every five.
  const LONGEST_PAUSE = 15;
  // An answer has the state as text, empty where there is no new one, its tag, and its age, s; or why there is none.
  // Answers of others than the server, such as the sign-in page of a proxy, have no age.
  const ask = async (address, tag) => {
    const headers = tag ? { "If-None-Match": tag } : {};
    const response = await fetch(`${address}/update`, { cache: "no-store", signal: AbortSignal.timeout(PATIENCE), headers });
    const text = await response.text();
    if (!response.ok && response.status !== 304) return { refusal: text || response.statusText };
    if (!response.headers.has("Age")) return { refusal: "Something else answers in its place, such as the sign-in of a proxy. Load this page again." };
    return { text: response.ok ? text : "", tag: response.headers.get("ETag") ?? "", age: +response.headers.get("Age") };
  };
  // "take" gets each answer, and returns the tag of the state that is shown then, or null where no other is to be asked
  // for; "miss" is told where none comes or "take" fails. After that, after a refusal, and after a state that "take" has
  // already, which comes where a proxy changes tags, the server is not asked at once again. "isEnded" says whether the
  // state that is shown is the last one of its session.
  const follow = async (address, take, miss, isEnded = () => false) => {
    let tag = "";
    while (tag !== null) {
      let isNew = false;
      try {
        const answer = await ask(address, tag);
        const isRepeated = answer.text && answer.tag === tag;
        tag = take(answer);
        isNew = !answer.refusal && !isRepeated;
      } catch { miss(); }
      if (!isNew) await new Promise(resolve => setTimeout(resolve, isEnded() ? RETRY_AFTER_END : RETRY));
    }
  };
  document.documentElement.updates = { follow, LONGEST_PAUSE };
})();
