// The status page. Asks the API of this server alone, draws only what changed, and asks for what is
// open and in sight alone: 8,000 nodes cost no more than 4.
"use strict";

const RATE_SECONDS = 10; // a rate is the mean of this time
const TIMES_SECONDS = 60; // response times weigh 1/e after this time
const FEW_PORTS = 128; // up to here all nets begin open
const LATELY_SECONDS = 600; // what was refused before is not of now
let last = null; // the last answers, and the time of day
const STATES = {
  silent: ["▲", "silent"],
  answering: ["●", "answering"],
  never_asked: ["○", "never asked"],
};

// ── Asking ──────────────────────────────────────────────────────────────────────────────────────

const TOKEN = "pnet-nat token"; // forgotten with the tab
class TokenNeeded extends Error {}

/** The answer to a request that carries the token. */
async function request(path, method = "GET") {
  const token = sessionStorage.getItem(TOKEN);
  const headers = token ? { authorization: `Bearer ${token}` } : {};
  const answer = await fetch(path, { method, headers, signal: AbortSignal.timeout(10_000) });
  if (answer.status === 401) throw new TokenNeeded();
  return answer;
}

/** What the API says; null where there is nothing. */
async function ask(path, method) {
  const answer = await request(path, method);
  if (answer.status === 404) return null;
  if (!answer.ok) throw new Error(`${answer.status} ${await answer.text()}`);
  return answer.json();
}

/** What is asked for in sight alone. */
class InSight {
  #seen = false;

  constructor(element, show) {
    this.show = show;
    new IntersectionObserver((changes) => {
      const appears = changes.at(-1).isIntersecting && !this.#seen;
      this.#seen = changes.at(-1).isIntersecting;
      if (appears && last) this.show().catch(() => {}); // the next round tells what is wrong
    }).observe(element);
  }

  async round() {
    if (this.#seen) await this.show();
  }
}

