//! The samples of `/metrics`, which tests look up by name and labels.

use std::collections::BTreeMap;

/// The samples of one scrape.
#[derive(Debug)]
pub struct Metrics(Vec<Sample>);

#[derive(Debug)]
struct Sample {
    name: String,
    labels: BTreeMap<String, String>,
    value: f64,
}

impl Metrics {
    /// Reads Prometheus' text format.
    pub fn parse(text: &str) -> Self {
        Self(text.lines().filter(|line| !line.starts_with('#')).map(Sample::parse).collect())
    }

    /// The sum of a family's samples that have these labels. Panics when there are none.
    pub fn sum(&self, name: &str, labels: &[(&str, &str)]) -> u64 {
        let has = |sample: &&Sample| {
            sample.name == name && labels.iter().all(|(key, value)| sample.label(key) == *value)
        };
        let samples: Vec<_> = self.0.iter().filter(has).map(|sample| sample.value).collect();
        assert!(!samples.is_empty(), "no sample of {name} with {labels:?}");
        samples.iter().sum::<f64>() as u64
    }

    /// How many datagrams were dropped, by direction and drop reason. Reasons at 0 are left out.
    pub fn drops(&self) -> BTreeMap<(String, String), u64> {
        let mut drops = BTreeMap::new();
        let dropped = |sample: &&Sample| sample.name == "pnet_nat_dropped_datagrams_total";
        for sample in self.0.iter().filter(dropped).filter(|sample| sample.value > 0.0) {
            let key = (sample.label("direction").to_owned(), sample.label("reason").to_owned());
            *drops.entry(key).or_default() += sample.value as u64;
        }
        drops
    }

    /// The counters that are smaller in this scrape than in an earlier one.
    pub fn behind(&self, earlier: &Self) -> Vec<String> {
        let counts = |sample: &&Sample| {
            ["_total", "_bucket", "_count", "_sum"].iter().any(|end| sample.name.ends_with(end))
        };
        let series = |sample: &'_ Sample| (sample.name.clone(), sample.labels.clone());
        let now: BTreeMap<_, _> =
            self.0.iter().filter(counts).map(|sample| (series(sample), sample.value)).collect();
        let behind = |sample: &Sample| {
            let value = *now.get(&series(sample))?;
            (value < sample.value).then(|| format!("{sample:?} is {value}"))
        };
        earlier.0.iter().filter(counts).filter_map(behind).collect()
    }

    /// The places where the law of the counters does not hold: received = forwarded + dropped, for
    /// every net, node and direction. Strays are included.
    pub fn breaches(&self) -> Vec<String> {
        let mut balances: BTreeMap<[&str; 3], f64> = BTreeMap::new();
        for sample in &self.0 {
            let sign = match sample.name.as_str() {
                "pnet_nat_received_datagrams_total" => 1.0,
                "pnet_nat_forwarded_datagrams_total" | "pnet_nat_dropped_datagrams_total" => -1.0,
                _ => continue,
            };
            let place = ["net", "node", "direction"].map(|label| sample.label(label));
            *balances.entry(place).or_default() += sign * sample.value;
        }
        assert!(balances.contains_key(&["none", "0", "response"]), "strays are counted too");
        let breach = |(place, balance): (_, f64)| {
            (balance != 0.0)
                .then(|| format!("{place:?}: received - forwarded - dropped = {balance}"))
        };
        balances.into_iter().filter_map(breach).collect()
    }
}

impl Sample {
    /// Reads `name{label="value",…} 1`. No label of the relay contains a comma or a quote.
    fn parse(line: &str) -> Self {
        let (series, value) = line.rsplit_once(' ').expect(line);
        let (name, labels) = series.split_once('{').unwrap_or((series, "}"));
        let labels = labels.trim_end_matches('}').split(',').filter(|label| !label.is_empty());
        let label = |label: &str| {
            let (key, value) = label.split_once('=').expect(line);
            (key.to_owned(), value.trim_matches('"').to_owned())
        };
        let value = value.parse().expect(line);
        Self { name: name.to_owned(), labels: labels.map(label).collect(), value }
    }

    fn label(&self, key: &str) -> &str {
        self.labels.get(key).map_or("", String::as_str)
    }
}
