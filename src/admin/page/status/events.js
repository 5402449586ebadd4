// ── What happened ───────────────────────────────────────────────────────────────────────────────

const FEW_EVENTS = 10;
const MOST_EVENTS = 500;
const EVENTS = {
  node_silent: ["▲", "bad"], reload_failed: ["▲", "bad"],
  throttled: ["▲", "doubtful"], flood_began: ["▲", "doubtful"],
  node_answers: ["●", "good"], flood_ended: ["●", "good"], reload: ["●", "good"],
};
let events = []; // newest first
let allEvents = false;

async function showEvents() {
  const { events: answered } = await ask(`api/v1/events?after=${events[0]?.number ?? 0}`);
  const newest = events[0]?.number ?? 0; // another question may have been answered first
  const news = answered.filter(({ number }) => number > newest);
  events = [...news, ...events].slice(0, MOST_EVENTS);
  const rows = allEvents ? events : events.slice(0, FEW_EVENTS);
  const shape = () => make("tr", {}, make("th", { scope: "row" }, make("time")),
    cell("", make("span", { "aria-hidden": "true" }), " ", make("span")));
  fillRows($("events").tBodies[0], rows, shape, ([when, what], { time, kind, text }) => {
    const [mark, state] = EVENTS[kind] ?? ["○", ""];
    write(when.firstChild, dayTime.format(time * 1000));
    when.firstChild.dateTime = new Date(time * 1000).toISOString();
    what.firstChild.className = state;
    write(what.firstChild, mark);
    write(what.lastChild, text);
  });
  $("events").hidden = events.length === 0;
  $("all-events").hidden = events.length <= FEW_EVENTS;
  write($("all-events"), allEvents ? "Show the newest alone" : `Show all ${whole.format(events.length)}`);
}

const happened = new InSight($("happened"), showEvents);
$("all-events").addEventListener("click", () => {
  allEvents = !allEvents;
  if (last) round();
});

