//! Two relays of one site, as one Prometheus sees them: whether they agree, and what the dashboard of many
//! relays asks.

use super::server::{Prometheus, has_prometheus};
use super::{FLEET, every_query_of_a_dashboard_has_an_answer, traffic};
use crate::harness::{Relay, Settings, Site, eventually};

#[test]
fn relays_of_a_site_are_compared() {
    if !has_prometheus() {
        return;
    }
    let (site, place) = (Site::claim(), Site::claim());
    let settings = Settings { net: "idle_timeout = \"3s\"", ..Settings::default() };
    let relay = site.relay(settings.clone());
    // The second has the same nodes, at addresses of its own, and the rules written another way.
    let public = |of: &Site| format!("[\"{}\"]", of.public_address());
    let admin = |of: &Site| format!("listen = \"{}\"", of.admin());
    let configuration = site
        .configuration(&settings)
        .replace(&public(&site), &public(&place))
        .replace(&admin(&site), &admin(&place))
        .replace("\"1-4\", 33", "33, \"1-2\", 3, 4");
    let other = Relay::start(&configuration, place.admin(), None);

    // A third is switched off.
    let targets = format!("targets: [\"{}\", \"{}:9\", ", place.admin(), site.address(9));
    let changes = [("targets: [", targets.as_str()), ("# labels: {site", "labels: {site")];
    let prometheus = Prometheus::start_with(&site, &changes);
    let relays = "count(pnet_nat_received_datagrams_total{net=\"section-1\",node=\"3\",direction=\"request\"})";
    eventually("both are scraped", || (prometheus.value(relays) == Some(2.0)).then_some(()));
    traffic(&site, &relay);
    let configurations = "site_net:pnet_nat_config_hash:count{site=\"dairy\",net=\"section-1\"}";
    let alert = "ALERTS{alertname=\"PnetNatConfigDiffers\",alertstate=\"firing\"}";
    prometheus.eventually(configurations);
    assert_eq!(prometheus.value("count(count by (hash) (pnet_nat_config_hash))"), Some(1.0));
    assert_eq!(prometheus.value(configurations), Some(1.0), "they have the same");
    assert_eq!(prometheus.query(alert).unwrap(), []);
    assert_eq!(prometheus.value("site:pnet_nat_build_info:count"), Some(1.0));

    other.reload_to(&configuration.replace("3s", "4s"));
    let fires = prometheus.eventually(alert);
    let told = ["site", "net"].map(|label| fires[0].0[label].as_str());
    assert_eq!(told, ["dairy", "section-1"]);
    let queries = every_query_of_a_dashboard_has_an_answer(&prometheus, FLEET);
    assert!(queries > 20, "{queries}");
    relay.finish();
    other.finish();
}
