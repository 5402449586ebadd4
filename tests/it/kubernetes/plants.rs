//! `deploy/kubernetes/plants`: many plants in one cluster, each with its own configuration.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use serde_json::Value;

use super::container::{EdgeNode, relays};
use super::{FOLDER, VERSIONS, build_changed, build_in, complaint, manifest, workload};

const PLANTS: [&str; 2] = ["brewery", "dairy"];

fn build(plant: &str) -> Option<String> {
    build_in(&Path::new(FOLDER).join("plants").join(plant))
}

#[test]
fn all_plants_are_built_at_once_and_share_nothing() {
    let Some(all) = build("") else { return };
    for version in VERSIONS {
        assert_eq!(complaint(&all, version), None);
    }
    let folders = fs::read_dir(Path::new(FOLDER).join("plants")).unwrap();
    let folders = folders.filter(|entry| entry.as_ref().unwrap().path().is_dir()).count();
    assert_eq!(
        (folders, all.matches("\nkind: Deployment\n").count()),
        (PLANTS.len(), PLANTS.len())
    );

    let mut own = BTreeSet::new();
    for plant in PLANTS {
        let Some(manifests) = build(plant) else { return };
        for document in manifests.split("\n---\n") {
            assert!(all.contains(document), "{document}");
        }
        let workload = workload(&manifests);
        let (template, pod) =
            (&workload["spec"]["template"], &workload["spec"]["template"]["spec"]);
        let [configuration, budget, namespace] = ["ConfigMap", "PodDisruptionBudget", "Namespace"]
            .map(|kind| manifest(&manifests, kind));
        let name = &namespace["metadata"]["name"];
        for ours in [&workload, &configuration, &budget] {
            assert_eq!(&ours["metadata"]["namespace"], name);
        }
        let sources = &pod["volumes"][0]["projected"]["sources"];
        assert_eq!(sources[0]["configMap"]["name"], configuration["metadata"]["name"]);
        let port = pod["containers"][0]["ports"][0]["containerPort"].to_string();
        let annotations = &template["metadata"]["annotations"];
        assert_eq!(annotations["prometheus.io/port"], port);
        let text = configuration["data"]["pnet-nat.toml"].as_str().unwrap();
        assert!(text.contains(&format!("\nlisten = \"0.0.0.0:{port}\"\n")), "{port}");
        // Two plants may share a node, and so its ports.
        for own_one in [name.to_string(), port, pod["nodeSelector"].to_string()] {
            assert!(own.insert(own_one.clone()), "{own_one} is another plant's too");
        }
        for port in public_ports(&manifests) {
            assert!(own.insert(port.clone()), "port {port} is another plant's too");
        }
    }
}

/// By `pnet-nat check` in the container: so all of its password files are there, too.
fn public_ports(manifests: &str) -> Vec<String> {
    let Some(node) = EdgeNode::new(manifests) else { return Vec::new() };
    let configuration = manifest(manifests, "ConfigMap");
    let configuration = configuration["data"]["pnet-nat.toml"].as_str().unwrap();
    let check = ["check", "--config", "/etc/pnet-nat/pnet-nat.toml", "--format", "json"];
    let mut container = node.run(check.into_iter(), configuration);
    let code = container.process.end();
    let checked: Value = serde_json::from_str(&container.process.stdout()).unwrap();
    assert_eq!((code, &checked["sound"]), (Some(0), &Value::Bool(true)), "{checked}");
    let rows = checked["nat_table"].as_array().unwrap();
    assert!(!rows.is_empty());
    rows.iter().map(|row| row["public_port"].to_string()).collect()
}

#[test]
fn a_plant_relays_as_its_manifest_has_it() {
    let Some(manifests) = build("dairy") else { return };
    relays(&manifests);
}

/// The line that README.md names, without its `#`.
#[test]
fn the_relays_of_a_plant_may_all_be_at_work_at_once() {
    let line = "\n#components: [../../active-active/daemonset]\n";
    let Some(manifests) = build_changed("plants/dairy", line, &line.replace('#', "")) else {
        return;
    };
    for version in VERSIONS {
        assert_eq!(complaint(&manifests, version), None);
    }
    let workload = workload(&manifests);
    assert_eq!(workload["kind"], "DaemonSet");
    let pod = &workload["spec"]["template"]["spec"];
    assert_eq!(pod["containers"][0]["ports"][0]["containerPort"], 9382);
}
