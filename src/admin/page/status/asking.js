// The status page. Asks the API of this server alone, draws only what changed, and asks for the
// nodes of those nets alone that are open and in sight: 8,000 of them cost no more than 4.
"use strict";

const RATE_SECONDS = 10; // a rate is the mean of this time
const TIMES_SECONDS = 60; // response times weigh 1/e after this time
const PLOT_SECONDS = 300;
const FEW_PORTS = 128; // up to here all nets begin open
const STATES = {
  answering: ["●", "answering"],
  silent: ["▲", "silent"],
  never_asked: ["○", "never asked"],
};

// ── Asking ──────────────────────────────────────────────────────────────────────────────────────

const TOKEN = "pnet-nat token"; // forgotten with the tab
class TokenNeeded extends Error {}

/** What the API says; null where there is nothing. */
async function ask(path) {
  const token = sessionStorage.getItem(TOKEN);
  const headers = token ? { authorization: `Bearer ${token}` } : {};
  const answer = await fetch(path, { headers, signal: AbortSignal.timeout(10_000) });
  if (answer.status === 401) throw new TokenNeeded();
  if (answer.status === 404) return null;
  if (!answer.ok) throw new Error(`${answer.status} ${await answer.text()}`);
  return answer.json();
}

