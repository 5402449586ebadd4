// ── A node ──────────────────────────────────────────────────────────────────────────────────────

/** Columns of figures; on a phone they stand beside the figures. */
const FIGURES = ["Requests", "Answers", "Median", "99 %", "Dropped"];
const DAY_MINUTES = 1440;

/** The states of a node over the day: a bar that is high while it was silent, low while it answered. */
class Strip {
  #shapes = new Map([["a", [7, 5]], ["s", [0, 12]], ["n", [11, 1]], ["-", [11.5, 0.5]]]);
  #letters = "";

  constructor() {
    this.title = svg("title");
    this.plot = svg("svg", { class: "strip", viewBox: `0 0 ${DAY_MINUTES} 12`, role: "img",
      preserveAspectRatio: "none" });
    this.paths = new Map([...this.#shapes.keys()].map((state) => [state, svg("path", { class: state.replace("-", "stopped") })]));
    this.plot.append(this.title, ...this.paths.values());
    this.note = make("small", { "aria-hidden": "true" });
    this.cell = make("td", { class: "day", "data-title": "24 hours" }, this.plot, this.note);
    this.plot.setAttribute("hidden", "");
  }

  /** One letter a minute, the last of them now. */
  show(time, letters) {
    if (this.#letters === letters) return;
    this.#letters = letters;
    this.plot.removeAttribute("hidden");
    const from = DAY_MINUTES - letters.length;
    const pens = new Map([...this.#shapes.keys()].map((state) => [state, ""]));
    const silences = [];
    for (const { 0: run, index } of letters.matchAll(/a+|s+|n+|-+/g)) {
      const [y, height] = this.#shapes.get(run[0]);
      pens.set(run[0], `${pens.get(run[0])}M${from + index} ${y}h${run.length}v${height}h${-run.length}z`);
      if (run[0] === "s") silences.push([index, index + run.length]);
    }
    for (const [state, path] of this.paths) path.setAttribute("d", pens.get(state));
    const at = (minute) => clock(time - 60 * (letters.length - minute));
    const words = ([first, end]) => (end === letters.length
      ? `silent since ${at(first)}` : `silent from ${at(first)} to ${at(end)}`);
    const told = silences.slice(-5).map(words);
    if (silences.length > told.length) told.unshift(`${whole.format(silences.length)} times silent`);
    const began = letters.search(/[^-]/);
    if (began > 0) told.unshift(`the relay runs since ${at(began)}`);
    if (!silences.length) told.push(letters.includes("a") ? "never silent" : "never asked");
    write(this.title, `The last 24 hours: ${told.join(", ")}`);
    const brief = words(silences.at(-1) ?? [0, 0]).replace("from ", "").replace(" to ", "–");
    write(this.note, silences.length ? brief : "");
  }
}

const VERDICTS = {
  good: ["●", "good"], doubtful: ["▲", "doubtful"], bad: ["▲", "bad"], unknown: ["○", "unknown"],
};

/** A row of a net's table; below it what a probe found. */
class NodeRow {
  traffic = new Traffic();
  strip = new Strip();

  constructor(net, node, canProbe) {
    this.net = net;
    this.node = node.node;
    const at = node.local_address === null ? "" : `${node.local_address}:`;
    const place = make("small", {}, `${at}${node.public_port} → ${node.server}`);
    const head = make("th", { scope: "row" }, nodeAddress(node.node), place);
    this.mark = make("span", { "aria-hidden": "true" });
    this.word = make("span");
    this.since = make("small");
    this.state = cell("", this.mark, " ", this.word, this.since);
    this.figures = FIGURES.map((title) =>
      make("td", { class: "number", "data-title": title }, make("span")));
    this.why = make("small");
    this.figures.at(-1).append(this.why);
    this.row = make("tr", { "data-node": node.node }, head, this.state, this.strip.cell, ...this.figures);
    this.rows = [this.row];
    if (!canProbe) return;
    this.button = make("button", { type: "button", "aria-label": `Probe ${nodeOf(net, node.node)}` }, "Probe");
    this.button.addEventListener("click", () => this.probe());
    place.before(this.button);
  }

  show(time, node) {
    this.traffic.add(time, node);
    const dropped = drops(node.request, node.response);
    const refused = node.state === "never_asked" ? refusals(node.request) : "";
    const [mark, word] = refused ? ["▲", "requests refused"] : STATES[node.state];
    const state = refused ? "refused" : node.state;
    if (this.row.dataset.state !== state) {
      this.state.className = state;
      this.row.dataset.state = state;
    }
    write(this.mark, mark);
    write(this.word, word);
    const [asked, answered] = [node.last_request_age_seconds, node.last_response_age_seconds];
    const no_answer = asked === null ? "" : "no answer so far";
    write(this.since, refused || (answered === null ? no_answer : `last answer ${age(answered)} ago`));
    const texts = [
      rate(this.traffic.requests),
      rate(this.traffic.answers),
      duration(this.traffic.quantile(0.5)),
      duration(this.traffic.quantile(0.99)),
      whole.format(total(dropped)),
    ];
    texts.forEach((text, i) => write(this.figures[i].firstChild, text));
    const why = Object.entries(dropped).map(([reason, count]) => `${reason}: ${count}`);
    write(this.why, why.join(", "));
    for (const row of this.rows) row.hidden = !isWanted(this.net, node, word);
  }

  /** Silent ones come first, then those whose clients are refused. */
  get rank() {
    return ["silent", "refused"].indexOf(this.row.dataset.state) + 1 || 3;
  }

  /** Has the router look at the node, and shows what it found. */
  async probe() {
    if (this.rows.length === 1) {
      this.result = make("div", { class: "checks", role: "status" });
      this.rows.push(make("tr", { class: "probe" },
        make("td", { colspan: this.row.cells.length }, this.result)));
      this.row.after(this.rows[1]);
    }
    write(this.result, "Asking the node …");
    const query = new URLSearchParams({ net: this.net, node: this.node });
    try {
      const found = await ask(`api/v1/probe?${query}`, "POST");
      if (!found) throw new Error("This node is not in the table any more, or [admin] probe is off.");
      const checks = found.checks.map(({ verdict, subject, text, remedy }) => {
        const [mark, word] = VERDICTS[verdict];
        const line = make("li", {}, make("b", { class: verdict }, `${mark} ${word}`), ` ${subject}: ${text}`);
        if (remedy) line.append(make("small", {}, remedy.replaceAll("`", "")));
        return line;
      });
      const close = make("button", { type: "button" }, "Close");
      close.addEventListener("click", () => {
        this.rows.pop().remove();
        this.button.focus();
      });
      this.result.replaceChildren(make("ul", {}, ...checks), close);
    } catch (error) {
      write(this.result, `The probe failed: ${error.message}`);
    }
  }
}

