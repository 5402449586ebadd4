// ── Who is connected ────────────────────────────────────────────────────────────────────────────

const SHOWN_CLIENTS = 100;
const FLOWS_SECONDS = 10; // a list wakes all workers
let flowsAt = -Infinity;

/** The flows of one client to one net are one line. */
function byClient(flows) {
  const clients = new Map();
  for (const flow of flows) {
    const key = `${flow.client} ${flow.net} ${flow.credential}`;
    const client = clients.get(key) ?? { ...flow, nodes: [], age: 0, idle: Infinity, sum: 0, size: 0 };
    clients.set(key, client);
    client.nodes.push(flow.node);
    client.age = Math.max(client.age, flow.age_seconds);
    client.idle = Math.min(client.idle, flow.idle_seconds);
    client.sum += flow.requests;
    client.size += flow.octets;
  }
  return [...clients.values()].sort((a, b) => a.idle - b.idle);
}

async function showFlows(time) {
  if (time - flowsAt < FLOWS_SECONDS) return;
  flowsAt = time;
  const { flows, credentials = [], complete } = await ask("api/v1/flows?limit=1000");
  const clients = byClient(flows);
  const shape = () => make("tr", {}, make("th", { scope: "row" }), cell(), cell(), cell(),
    ...Array.from({ length: 4 }, () => cell("number")));
  fillRows($("clients").tBodies[0], clients.slice(0, SHOWN_CLIENTS), shape, (cells, client) => {
    const { client: address, net, nodes, credential, age: since, idle, sum, size } = client;
    [address, net, ranges(nodes), credential ?? "none", age(since), age(idle), whole.format(sum), octets(size)]
      .forEach((text, i) => write(cells[i], text));
  });
  $("clients").hidden = clients.length === 0;
  const hidden = clients.length - SHOWN_CLIENTS;
  const more = complete === false ? "Of the first 1,000 flows; pnet-nat flows has all. " : "";
  write($("clients-note"), !clients.length ? "Nobody is connected."
    : more + (hidden > 0 ? `${whole.format(hidden)} more clients: pnet-nat flows.` : ""));
  const password = () => make("tr", {}, make("th", { scope: "row" }), cell(), cell("number"), cell("number"));
  fillRows($("credentials").tBodies[0], credentials, password, (cells, use) => {
    [use.credential, use.net, whole.format(use.accepted_requests), whole.format(use.flows)]
      .forEach((text, i) => write(cells[i], text));
  });
  $("credentials").hidden = credentials.length === 0;
}

const connected = new InSight($("connected"), async () => {
  if ($("connected").open) await showFlows(performance.now() / 1000);
});
$("connected").addEventListener("toggle", () => {
  flowsAt = -Infinity;
  if (last) round();
});

