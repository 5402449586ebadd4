// ── Round after round ───────────────────────────────────────────────────────────────────────────

let timer = 0;
let running = false;
let started = null; // when the relay did, by its own count

async function poll() {
  reasons ??= await ask("api/v1/drop-reasons");
  const [status, { nets: states }] =
    await Promise.all([ask("api/v1/status"), ask("api/v1/nets?nodes=false")]);
  const time = performance.now() / 1000;
  if (started !== null && Math.abs(time - status.uptime_seconds - started) > 5) events = [];
  started = time - status.uptime_seconds;
  if (last && time - last.time > pause) filled = -Infinity;
  last = { status, states, time, at: new Date().toLocaleTimeString() };
  $("status").hidden = false;
  $("status").className = "";
  $("token-form").hidden = true;
  const dropped = drops(status.stray_responses,
    ...states.flatMap(({ request, response }) => [request, response]));
  const kernel = drops(
    ...states.map((net) => named("kernel: ", net.kernel_dropped_datagrams)),
    named("kernel: upstream ", status.upstream_kernel_dropped_datagrams));
  await readRefused(time, JSON.stringify(states.map((net) => drops(net.request))));
  showBanner(status, states, null, time);
  showRefused(time);
  showTiles(time, status, states, dropped);
  showNets(time, states, status);
  showDrops(time, { ...dropped, ...kernel });
  showRelay(status, states);
  // Only then what asks for more.
  if (filterWords.length) await applyFilter();
  await showPlots(time);
  for (const net of nets.values()) {
    if (net.details.open && net.inSight) await net.look();
  }
  await connected.round();
  await happened.round();
}

async function round() {
  clearTimeout(timer);
  if (document.hidden || running) return; // `visibilitychange` wakes it up
  running = true;
  const began = performance.now();
  try {
    await poll();
  } catch (error) {
    if (error instanceof TokenNeeded) {
      running = false;
      return askForToken();
    }
    if (last) {
      $("status").className = "stale";
      showBanner(last.status, last.states, last.at, performance.now() / 1000);
    } else {
      write($("process"), `No answer: ${error.message}`);
    }
  }
  running = false;
  // A relay or browser that is slow is asked less often.
  const wait = Math.max(2000, 10 * (performance.now() - began));
  pause = Math.max(RATE_SECONDS, (3 * wait) / 1000);
  timer = setTimeout(round, wait);
}

function askForToken() {
  const refused = sessionStorage.getItem(TOKEN) !== null;
  sessionStorage.removeItem(TOKEN);
  $("status").hidden = true;
  $("token-form").hidden = false;
  write($("token-error"), refused ? "This is not the token." : "");
  $("token").focus();
}

$("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem(TOKEN, $("token").value.trim());
  $("token").value = "";
  round();
});
document.addEventListener("visibilitychange", () => {
  if ($("token-form").hidden) round(); // without the token there is nothing to ask
});
round();
