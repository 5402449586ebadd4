// ── Figures over time ───────────────────────────────────────────────────────────────────────────

/** So many seconds without a look are a pause: what happened then says nothing of now. */
let pause = RATE_SECONDS;

/** The rate of a counter. */
class Rate {
  #samples = [];

  add(time, value) {
    const samples = this.#samples;
    const [before, count] = samples.at(-1) ?? [time, value];
    if (value < count || time - before > pause) samples.length = 0; // it, or we, began anew
    samples.push([time, value]);
    while (samples.length > 2 && samples[1][0] <= time - RATE_SECONDS) samples.shift();
    return this.now;
  }

  /** Null before there are two samples. */
  get now() {
    const [[since, from], [until, to]] = [this.#samples[0], this.#samples.at(-1)];
    return until > since ? (to - from) / (until - since) : null;
  }
}

/** Response times, those of late above all: a histogram that fades. */
class Times {
  #last = null;
  #weights = new Map(); // by upper bound: answers, and the sum of their times

  /** Adds what the API has of one node, of one net, or of several in a row. */
  add(times, elapsed) {
    const now = new Map();
    for (const { up_to_seconds, answers, sum_seconds } of times) {
      const bound = up_to_seconds ?? Infinity;
      const [count, sum] = now.get(bound) ?? [0, 0];
      now.set(bound, [count + answers, sum + sum_seconds]);
    }
    const restarted = [...(this.#last ?? [])].some(([bound, [count]]) => !(now.get(bound)?.[0] >= count));
    if (!this.#last || restarted) {
      // All since the start weighs as much as one answer, until there are others.
      const all = [...now.values()].reduce((all, [count]) => all + count, 0);
      this.#weights = new Map([...now].map(([bound, [count, sum]]) => [bound, [count / all, sum / all]]));
    } else {
      const fade = Math.exp(-elapsed / TIMES_SECONDS);
      for (const [bound, [count, sum]] of now) {
        const [weight, time] = this.#weights.get(bound) ?? [0, 0];
        const [counted, summed] = elapsed > pause ? [count, sum] : this.#last.get(bound) ?? [0, 0];
        this.#weights.set(bound, [weight * fade + (count - counted), time * fade + (sum - summed)]);
      }
    }
    this.#last = now;
  }

  /** Seconds, as the API has it: the mean of a bucket, of which two digits are true. Null without
   * answers. */
  quantile(share) {
    const buckets = [...this.#weights].sort(([a], [b]) => a - b);
    const all = buckets.reduce((all, [, [weight]]) => all + weight, 0);
    let below = 0;
    for (const [bound, [weight, time]] of buckets) {
      below += weight;
      if (weight > 0 && below >= share * all) return Math.min(time / weight, bound);
    }
    return null;
  }
}

/** The traffic of a net, of a node, or of all. */
class Traffic {
  #requests = new Rate();
  #answers = new Rate();
  #times = new Times();
  #before = null;

  add(time, state) {
    this.requests = this.#requests.add(time, state.request.forwarded_datagrams);
    this.answers = this.#answers.add(time, state.response.forwarded_datagrams);
    this.#times.add(state.response_times, time - (this.#before ?? time));
    this.#before = time;
  }

  quantile(share) {
    return this.#times.quantile(share);
  }
}

