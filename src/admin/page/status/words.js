// ── Words ───────────────────────────────────────────────────────────────────────────────────────

const whole = new Intl.NumberFormat("en");
const rough = new Intl.NumberFormat("en", { maximumSignificantDigits: 2 });
const compact = new Intl.NumberFormat("en", { maximumSignificantDigits: 2, notation: "compact" });
const hourMinute = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit" });
const dayTime = new Intl.DateTimeFormat("en-GB", { weekday: "short", day: "numeric", month: "short",
  hour: "2-digit", minute: "2-digit", second: "2-digit" });

const rate = (value) => (value === null ? "–" : `${rough.format(value)} /s`);

function duration(seconds) {
  if (seconds === null) return "–";
  return seconds < 1 ? `${rough.format(seconds * 1000)} ms` : `${rough.format(seconds)} s`;
}

function age(seconds) {
  for (const [unit, length] of [["d", 86400], ["h", 3600], ["min", 60]]) {
    if (seconds >= 2 * length) return `${Math.floor(seconds / length)} ${unit}`;
  }
  return seconds < 10 ? `${seconds.toFixed(1)} s` : `${Math.floor(seconds)} s`;
}

function octets(count) {
  for (const [unit, size] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]]) {
    if (count >= size) return `${rough.format(count / size)} ${unit}`;
  }
  return `${count} B`;
}

const counted = (count, one, many = `${one}s`) => `${whole.format(count)} ${count === 1 ? one : many}`;
const nodes = (count) => counted(count, "node");

/** What the relay has as the node address of a PROFINET device, which has none. */
const NO_NODE = 0;

const nodeAddress = (node) => (node === NO_NODE ? "–" : `${node}`);
const nodeOf = (net, node) => (node === NO_NODE ? net : `node ${node} of ${net}`);

/** Node addresses, those in a row as a range: 1–4, 33. */
function ranges(numbers) {
  const sorted = [...new Set(numbers)].sort((a, b) => a - b);
  const parts = [];
  for (const number of sorted) {
    const part = parts.at(-1);
    if (part && part[1] === number - 1) part[1] = number;
    else parts.push([number, number]);
  }
  return parts.map(([from, to]) => (from === to ? nodeAddress(from) : `${from}–${to}`)).join(", ");
}

/** Seconds of the relay's clock where `performance.now()` is 0. */
let epoch = (Date.now() - performance.now()) / 1000;

/** The time of day at a time of `performance.now()`, in seconds. */
const clock = (time) => hourMinute.format((epoch + time) * 1000);

