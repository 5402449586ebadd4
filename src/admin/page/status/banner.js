// ── The banner ──────────────────────────────────────────────────────────────────────────────────

const SHOWN_SILENT = 12;
const SHOWN_FAULTS = 8;
let links = new Map(); // the buttons to silent nodes

/** What is wrong with the relay itself. */
function relayFaults(status, lost) {
  const lines = [];
  if (lost) lines.push(`The relay has not answered since ${lost}. These are its last figures.`);
  if (!status.ready) lines.push("The relay is not relaying: it starts or stops.");
  if (status.reload.successful) return lines;
  const { error, faults, not_in_force: items } = status.reload;
  if (error) {
    lines.push(`The last reload failed, and the configuration before it is in force: ${error}`,
      ...faults.slice(0, SHOWN_FAULTS));
    const rest = faults.length - SHOWN_FAULTS;
    if (rest > 0) lines.push(`And ${counted(rest, "more fault")}: pnet-nat check tells all of them.`);
  }
  lines.push(...items.map(({ what, why }) => `Not in force: ${what}: ${why}`));
  return lines;
}

function showBanner(status, states, lost, time) {
  const lines = relayFaults(status, lost);
  const silent = states.flatMap((net) => net.silent_nodes.map((node) => [net.name, node]));
  const answering = states.reduce((sum, net) => sum + net.answering_nodes, 0);
  const bad = lines.length > 0 || silent.length > 0;
  if (silent.length) lines.push(`▲ ${silent.length === 1 ? "1 node is" : `${nodes(silent.length)} are`} silent:`);
  const { reasons: lately, newest } = refusedLately(time);
  // Requests came, and no node has answered any: then it is no good sign that none is silent.
  const never = answering ? "" : refusals(...states.map((net) => net.request));
  if (!bad && never) {
    lines.push(`▲ No client has had an answer yet: ${never}. Below it says what that means.`);
  } else if (!bad) {
    lines.push(answering ? `● ${answering === 1 ? "The one node" : `All ${nodes(answering)}`} that clients asked ${answering === 1 ? "answers" : "answer"}.`
      : "○ Relaying. No client has had an answer yet.");
  }
  const doubtful = never || total(lately) > 0;
  const title = status.title ?? "pnet-nat";
  const news = [silent.length ? `${whole.format(silent.length)} silent` : "", doubtful ? "requests refused" : ""];
  document.title = [...news.filter(Boolean), title].join(" · ");
  $("banner").className = bad ? "bad" : doubtful ? "doubtful" : "good";
  const places = $("banner-lines");
  while (places.children.length > lines.length) places.lastChild.remove();
  lines.forEach((line, i) => write(places.children[i] ?? places.appendChild(make("p")), line));
  showLinks(silent);
  $("refused-line").hidden = !total(lately);
  const each = Object.entries(lately).sort(([, a], [, b]) => b - a);
  const reasons = each.map(([reason, count]) => (each.length > 1 ? `${reason} (${whole.format(count)})` : reason));
  write($("refused-sum"), `▲ ${counted(total(lately), "request")} refused: ${reasons.join(", ")}. The last was ${age(newest)} ago. `);
}

/** A button for each of the first silent nodes. Those that stay keep the focus. */
function showLinks(silent) {
  const shown = silent.slice(0, SHOWN_SILENT);
  const before = links;
  links = new Map();
  for (const [name, node] of shown) {
    const text = node === NO_NODE ? name : `${name}, node ${node}`;
    let link = before.get(text);
    if (!link) {
      link = make("button", { type: "button" }, text);
      link.addEventListener("click", () => find(name, node));
    }
    links.set(text, link);
  }
  arrange($("silent-links"), [...links.values()]);
  const rest = silent.length - shown.length;
  write($("silent-rest"), rest > 0 ? `and ${whole.format(rest)} more ` : "");
  $("silent").hidden = silent.length === 0;
}

$("silent-help").addEventListener("click", () => {
  $("help").open = true;
  goTo($("help").firstElementChild);
});
$("refused-link").addEventListener("click", () => goTo($("refused-place")));

