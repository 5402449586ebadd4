//! How routers choose a next hop by the hash of a datagram, of 31 bits. All next hops weigh the same.

pub(crate) trait Spread {
    /// The relays that have the route now, in the order of the router's list.
    fn change(&mut self, now: u64, live: &[u16]);

    /// Where datagrams with this hash go.
    fn relay(&self, hash: u32) -> u16;

    /// When the router moves clients by itself.
    fn due(&self) -> Option<u64> {
        None
    }

    /// It does.
    fn force(&mut self) {}
}

/// Linux, a route or a group of next hops: each has a range of hashes, and a change moves the borders of all
/// (`fib_rebalance` and `fib_select_multipath`; RFC 2992).
#[derive(Default)]
pub(crate) struct Threshold {
    live: Vec<u16>,
    /// The last hash of each range.
    upper_bounds: Vec<u32>,
}

impl Spread for Threshold {
    fn change(&mut self, _: u64, live: &[u16]) {
        let total = live.len() as u64;
        self.upper_bounds.clear();
        self.upper_bounds.extend((1..=total).map(|w| (divide(w << 31, total) - 1) as u32));
        self.live = live.to_vec();
    }

    fn relay(&self, hash: u32) -> u16 {
        // The kernel goes through the list. The result is the same.
        self.live[self.upper_bounds.partition_point(|&upper_bound| hash > upper_bound)]
    }
}

/// Simple hardware: the remainder is the place in the list.
#[derive(Default)]
pub(crate) struct Modulo(Vec<u16>);

impl Spread for Modulo {
    fn change(&mut self, _: u64, live: &[u16]) {
        self.0 = live.to_vec();
    }

    fn relay(&self, hash: u32) -> u16 {
        self.0[hash as usize % self.0.len()]
    }
}

/// Linux, a resilient group: the remainder is a bucket, and a bucket stays with its next hop as long as that is
/// there. A next hop with too few buckets takes those that belong to nobody, those that are idle, and after
/// `timer` those of next hops with too many (`nh_res_table_upkeep`).
pub(crate) struct Resilient {
    buckets: Vec<Option<u16>>,
    /// Buckets without a client. A client polls more often than any idle timer of use, so others are never idle.
    idle: Vec<bool>,
    /// `unbalanced_timer`. Without it, nothing is forced.
    timer: Option<u64>,
    unbalanced_since: Option<u64>,
    /// By relay: how many buckets it has, and how many it is due.
    count: Vec<usize>,
    wants: Vec<usize>,
    /// Relays with too few, the last first.
    underweight: Vec<u16>,
}

impl Resilient {
    pub(crate) fn new(buckets: usize, timer: Option<u64>, relays: usize, clients: &[u32]) -> Self {
        let mut idle = vec![true; buckets];
        clients.iter().for_each(|&hash| idle[hash as usize % buckets] = false);
        let (buckets, underweight) = (vec![None; buckets], Vec::new());
        let (count, wants) = (vec![0; relays], vec![0; relays]);
        Self { buckets, idle, timer, unbalanced_since: None, count, wants, underweight }
    }

    fn upkeep(&mut self, force: bool) {
        for (bucket, idle) in self.buckets.iter_mut().zip(&self.idle) {
            let Some(&to) = self.underweight.last() else { break };
            if let Some(from) = bucket.map(usize::from) {
                if self.count[from] <= self.wants[from] || !idle && !force {
                    continue;
                }
                self.count[from] -= 1;
            }
            *bucket = Some(to);
            self.count[usize::from(to)] += 1;
            if self.count[usize::from(to)] == self.wants[usize::from(to)] {
                self.underweight.pop();
            }
        }
        if self.underweight.is_empty() {
            self.unbalanced_since = None;
        }
    }
}

impl Spread for Resilient {
    fn change(&mut self, now: u64, live: &[u16]) {
        self.wants.fill(0);
        self.underweight.clear();
        let (buckets, total) = (self.buckets.len() as u64, live.len() as u64);
        let mut before = 0;
        for (&relay, w) in live.iter().zip(1..) {
            let upper_bound = divide(buckets * w, total) as usize;
            self.wants[usize::from(relay)] = upper_bound - before;
            before = upper_bound;
        }
        for bucket in &mut self.buckets {
            if let Some(relay) = bucket.filter(|&relay| self.wants[usize::from(relay)] == 0) {
                self.count[usize::from(relay)] -= 1;
                *bucket = None;
            }
        }
        let needs = |relay: &u16| self.count[usize::from(*relay)] < self.wants[usize::from(*relay)];
        self.underweight.extend(live.iter().copied().filter(needs));
        if !self.underweight.is_empty() {
            self.unbalanced_since.get_or_insert(now);
        }
        self.upkeep(false);
    }

    fn relay(&self, hash: u32) -> u16 {
        self.buckets[hash as usize % self.buckets.len()].expect("each bucket has a relay")
    }

    fn due(&self) -> Option<u64> {
        Some(self.unbalanced_since? + self.timer?)
    }

    fn force(&mut self) {
        self.upkeep(true);
    }
}

/// The nearest whole number, as the kernel's `DIV_ROUND_CLOSEST`.
fn divide(a: u64, b: u64) -> u64 {
    (a + b / 2) / b
}
