// ── What was dropped ────────────────────────────────────────────────────────────────────────────

/** How often datagrams were dropped, by reason: of both directions of one place. */
function drops(...directions) {
  const sums = {};
  for (const { dropped_datagrams } of directions) {
    for (const [reason, count] of Object.entries(dropped_datagrams)) {
      sums[reason] = (sums[reason] ?? 0) + count;
    }
  }
  return sums;
}

/** Why requests were not passed on, most frequent first, in words; empty when all were. */
function refusals(...requests) {
  const reasons = Object.entries(drops(...requests)).sort(([, a], [, b]) => b - a);
  const sum = total(Object.fromEntries(reasons));
  return sum ? `${counted(sum, "request")} refused: ${reasons.map(([reason]) => reason).join(", ")}` : "";
}

/** What the kernel dropped, by the names that `reasons` has for it. */
const named = (place, causes) => ({
  dropped_datagrams: Object.fromEntries(
    Object.entries(causes).map(([cause, count]) => [place + cause, count])),
});

const total = (counts) => Object.values(counts).reduce((a, b) => a + b, 0);

let reasons = null;
const REASON_RATES = new Map();

/** A reason in words. */
const meaning = (reason) => (reasons[reason] ?? "").replaceAll("`", "");

function showDrops(time, dropped) {
  const rates = new Map();
  for (const reason of Object.keys(reasons)) {
    if (!REASON_RATES.has(reason)) REASON_RATES.set(reason, new Rate());
    rates.set(reason, REASON_RATES.get(reason).add(time, dropped[reason] ?? 0));
  }
  const rows = Object.entries(dropped).filter(([, count]) => count).sort(([, a], [, b]) => b - a);
  $("no-drops").hidden = rows.length > 0;
  $("drops").hidden = rows.length === 0;
  const shape = () => make("tr", {}, make("th", { scope: "row" }, make("code")),
    cell("number"), cell("number"), cell());
  fillRows($("drops").tBodies[0], rows, shape, ([name, sum, perSecond, words], [reason, count]) => {
    write(name.firstChild, reason);
    write(sum, whole.format(count));
    write(perSecond, rate(rates.get(reason) ?? null));
    write(words, meaning(reason));
  });
}

