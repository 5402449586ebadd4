// ── Which nodes are shown ───────────────────────────────────────────────────────────────────────

let filterWords = []; // the words of the filter
let directory = new Map(); // the nodes of each net with their addresses
let directoryOf = ""; // the configuration that it is of

/** Whether a node is one that the filter leaves. A number is a node or a public port; any other word
 * stands in the net's name, in an address, or in the state. */
function isWanted(net, node, state) {
  const { local_address: local, public_port: port, server } = node;
  const what = node.node === NO_NODE ? "device" : `node ${node.node}`;
  const text = `${net} ${what} ${local ? `${local}:` : ""}${port} ${server} ${state}`.toLowerCase();
  return filterWords.every((word) =>
    (/^\d+$/.test(word) ? [node.node, port].includes(Number(word)) : text.includes(word)));
}

/** Has the addresses of all nodes, once for each configuration. */
async function readDirectory(status) {
  const of = `${status.reload.number} ${status.reload.successful} ${status.public_ports}`;
  if (of === directoryOf) return;
  const config = await ask("api/v1/config");
  directory = new Map(config.nets.map(({ name, nodes }) => [name, nodes]));
  directoryOf = of;
}

/** How many nodes of a net the filter leaves. Of those that are not silent, only their own row knows
 * more, so they may be in any other state. */
function wantedOf(net, silent) {
  const others = "answering never asked requests refused";
  return (directory.get(net) ?? []).filter((node) =>
    isWanted(net, node, silent.has(node.node) ? "silent" : others)).length;
}

/** Leaves those nets that have a node for it, and opens them; without words, leaves all as they were. */
async function applyFilter(opens = false) {
  try {
    if (filterWords.length && last) await readDirectory(last.status);
  } catch {
    return; // the next round tells what is wrong
  }
  $("nets").className = filterWords.length ? "filtered" : "";
  let [found, places] = [0, 0];
  for (const net of nets.values()) {
    const count = filterWords.length ? net.filter(opens) : net.unfilter();
    found += count;
    places += count > 0;
  }
  write($("filter-note"), filterWords.length ? `${nodes(found)} in ${counted(places, "net")}` : "");
}

function setFilter(text) {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  if (words.join(" ") === filterWords.join(" ")) return Promise.resolve();
  filterWords = words;
  return applyFilter(true);
}

$("filter").addEventListener("input", ({ target }) => setFilter(target.value));

