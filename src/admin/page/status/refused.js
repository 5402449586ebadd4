// ── Who is refused ──────────────────────────────────────────────────────────────────────────────

const SHOWN_REFUSED = 50;
let refused = { refused: [], not_listed: 0 };
let refusedAt = 0; // when that was asked for; ages count from then
let refusedKey = null; // what had been dropped then

/** What a sender did, in words. */
function offence({ net, node, reason }) {
  const of = nodeOf(net, node);
  return {
    source_not_allowed: `is not in allow of ${net}`,
    password_missing: `sends no password to ${of}`,
    password_wrong: `sends a wrong password to ${of}`,
    throttled: `has sent too many wrong passwords to ${net}`,
    node_mismatch: `names another node on the port of ${of}`,
    flow_limit: `is a new client, and ${net} has no flow left`,
    request_limit: `sends too many requests to ${of}`,
  }[reason] ?? `sends to ${of}`;
}

/** Asks again when something was dropped since. */
async function readRefused(time, key) {
  if (key === refusedKey) return;
  refused = await ask("api/v1/refused");
  [refusedAt, refusedKey] = [time, key];
}

/** Scanners of the Internet cause these all day; they are listed, and make nothing amber. */
const NOISE = new Set(["too_short", "too_long", "bad_header", "bad_route", "bad_length", "bad_ndr"]);

/** How often well-formed requests were refused lately, by reason, and how long ago the last was. */
function refusedLately(time) {
  const reasons = {};
  let newest = Infinity;
  for (const { direction, reason, count, last_age_seconds } of refused.refused) {
    if (direction !== "request" || NOISE.has(reason)) continue;
    const seconds = last_age_seconds + time - refusedAt;
    if (seconds > LATELY_SECONDS) continue;
    newest = Math.min(newest, seconds);
    reasons[reason] = (reasons[reason] ?? 0) + count;
  }
  return { reasons, newest };
}

function showRefused(time) {
  const all = refused.refused;
  $("refused").hidden = all.length === 0;
  const rows = all.slice(0, SHOWN_REFUSED);
  const shape = () => make("tr", {}, make("th", { scope: "row" }), cell("", make("span"), make("small")),
    ...["Times", "First", "Last"].map((title) => make("td", { class: "number", "data-title": title })));
  fillRows($("refused").tBodies[0], rows, shape, ([source, why, times, first, latest], entry) => {
    const elapsed = time - refusedAt;
    write(source, entry.source);
    write(why.firstChild, offence(entry));
    write(why.lastChild, `${entry.reason}: ${meaning(entry.reason)}`);
    write(times, whole.format(entry.count));
    write(first, `${age(entry.first_age_seconds + elapsed)} ago`);
    write(latest, `${age(entry.last_age_seconds + elapsed)} ago`);
  });
  const notes = [];
  if (all.length > rows.length) notes.push(`${whole.format(all.length - rows.length)} more: pnet-nat status --refused.`);
  if (refused.not_listed) notes.push(`${counted(refused.not_listed, "more request was", "more requests were")} refused, of senders that found no place in this table.`);
  write($("refused-note"), all.length ? notes.join(" ") : "Nobody was refused.");
}

