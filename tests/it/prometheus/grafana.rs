//! The files that provision Grafana, as far as they can be judged without it: they fit together, and
//! `deploy/compose.yaml` puts them where Grafana looks.

use serde_json::{Value, json};

use super::{DASHBOARD, FLEET};
use crate::harness::{has_yaml, yaml};

const COMPOSE: &str = include_str!("../../../deploy/compose.yaml");
const PROMETHEUS: &str = include_str!("../../../deploy/prometheus/prometheus.yml");
const DATASOURCES: &str =
    include_str!("../../../deploy/grafana/provisioning/datasources/prometheus.yaml");
const DASHBOARDS: &str =
    include_str!("../../../deploy/grafana/provisioning/dashboards/pnet-nat.yaml");

/// The one document of a text.
fn read(text: &str) -> Value {
    let mut documents = yaml(text);
    assert_eq!(documents.len(), 1);
    documents.remove(0)
}

/// Where compose has a folder of `deploy` mounted.
fn mounted(service: &Value, source: &str) -> String {
    let volumes = service["volumes"].as_array().unwrap().iter().map(|it| it.as_str().unwrap());
    let mut parts = volumes.map(|volume| volume.split(':').collect::<Vec<_>>());
    parts.find(|parts| parts[0] == source).expect(source)[1].to_owned()
}

#[test]
fn the_data_source_is_the_prometheus_of_compose() {
    if !has_yaml() {
        return;
    }
    let (provisioned, compose) = (read(DATASOURCES), read(COMPOSE));
    assert_eq!(provisioned["apiVersion"], 1);
    let [source] = provisioned["datasources"].as_array().unwrap().as_slice() else { panic!() };
    let keys: Vec<_> = source.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(keys, ["access", "isDefault", "jsonData", "name", "type", "url"]);
    assert_eq!((&source["type"], &source["access"]), (&json!("prometheus"), &json!("proxy")));
    assert_eq!(source["isDefault"], true);
    let scraped = &read(PROMETHEUS)["global"]["scrape_interval"];
    assert_eq!(&source["jsonData"]["timeInterval"], scraped);

    // Grafana is in the network of Prometheus, whose port there is the one that is published.
    let services = &compose["services"];
    assert_eq!(services["grafana"]["network_mode"], "service:prometheus");
    let port = source["url"].as_str().unwrap().strip_prefix("http://127.0.0.1:").unwrap();
    let published = services["prometheus"]["ports"].as_array().unwrap();
    let ends = |end: &str| published.iter().any(|port| port.as_str().unwrap().ends_with(end));
    assert!(ends(&format!("${{PROMETHEUS_PORT-{port}}}:{port}")), "{published:?}");
    assert!(ends(":3000"), "Grafana's own: {published:?}");
    assert_eq!(
        mounted(&services["grafana"], "./grafana/provisioning"),
        "/etc/grafana/provisioning"
    );
}

#[test]
fn the_dashboard_is_where_its_provider_looks() {
    if !has_yaml() {
        return;
    }
    let (provisioned, compose) = (read(DASHBOARDS), read(COMPOSE));
    assert_eq!(provisioned["apiVersion"], 1);
    let [provider] = provisioned["providers"].as_array().unwrap().as_slice() else { panic!() };
    assert_eq!(provider["type"], "file");
    let grafana = &compose["services"]["grafana"];
    let folder = mounted(grafana, "./grafana/dashboards");
    assert_eq!(provider["options"]["path"], folder.as_str());
    let home = &grafana["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"];
    assert_eq!(home, &json!(format!("{folder}/pnet-nat.json")));
}

/// Whatever id Grafana gives to it.
#[test]
fn the_dashboards_ask_the_data_source_that_is_chosen() {
    for (dashboard, least) in [(DASHBOARD, 20), (FLEET, 10)] {
        asks_what_is_chosen(&serde_json::from_str(dashboard).unwrap(), least);
    }
}

fn asks_what_is_chosen(dashboard: &Value, least: usize) {
    let variables = dashboard["templating"]["list"].as_array().unwrap();
    let chosen = variables.iter().find(|variable| variable["name"] == "datasource").unwrap();
    assert_eq!((&chosen["type"], &chosen["query"]), (&json!("datasource"), &json!("prometheus")));
    let panels = dashboard["panels"].as_array().unwrap();
    let panels = panels.iter().filter(|panel| panel["type"] != "row");
    let queried = variables.iter().filter(|variable| variable["type"] == "query");
    let annotations = dashboard["annotations"]["list"].as_array().unwrap();
    let all: Vec<_> = panels.chain(queried).chain(annotations).collect();
    assert!(all.len() > least, "{}", all.len());
    for asking in all {
        let source = json!({ "type": "prometheus", "uid": "${datasource}" });
        assert_eq!(asking["datasource"], source, "{asking}");
    }
}

/// Whatever a panel or the head of a dashboard leads to is a dashboard, with variables that it has.
#[test]
fn the_dashboards_lead_to_each_other() {
    let dashboards = [DASHBOARD, FLEET].map(|text| serde_json::from_str::<Value>(text).unwrap());
    let mut links = 0;
    for (dashboard, other) in dashboards.iter().zip(dashboards.iter().rev()) {
        let head = dashboard["links"].as_array().unwrap().iter();
        let to = head.map(|link| link["url"].as_str().unwrap()).collect::<Vec<_>>();
        let uid = other["uid"].as_str().unwrap();
        assert_eq!(to, [format!("/d/{uid}/{uid}")], "the head leads to the other one");
        let text = dashboard.to_string();
        for url in text.split("\"url\":\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
            let uid = url.split(['/', '?']).nth(2).unwrap();
            let led_to = dashboards.iter().find(|dashboard| dashboard["uid"] == uid).expect(url);
            let variables = led_to["templating"]["list"].as_array().unwrap();
            for name in url.split("&var-").skip(1).map(|rest| rest.split('=').next().unwrap()) {
                assert!(variables.iter().any(|variable| variable["name"] == name), "{url}: {name}");
            }
            links += 1;
        }
    }
    assert!(links > 5, "{links}");
}

/// The worst comes first.
#[test]
fn the_tables_of_the_fleet_are_sorted() {
    let fleet: Value = serde_json::from_str(FLEET).unwrap();
    let panels = fleet["panels"].as_array().unwrap();
    let tables: Vec<_> = panels.iter().filter(|panel| panel["type"] == "table").collect();
    assert_eq!(tables.len(), 4);
    for table in tables {
        let sort = &table["options"]["sortBy"][0];
        assert_eq!(sort["desc"], true, "{}", table["title"]);
        let organize = table["transformations"].as_array().unwrap().last().unwrap();
        let mut names = organize["options"]["renameByName"].as_object().unwrap().values();
        assert!(names.any(|name| *name == sort["displayName"]), "{}", table["title"]);
    }
}
