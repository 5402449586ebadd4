//! `deploy/kubernetes/active-active`: what announces the address, what relays, and the configuration have to
//! agree. The kinds of MetalLB and Cilium are in no schema here; `active-active.md` says how they are checked.

use std::path::Path;

use nix::sys::signal::Signal;
use serde_json::Value;

use super::container::{EdgeNode, value};
use super::{
    FOLDER, VERSIONS, assert_that_one_goes_after_the_other, build_changed, build_in, complaint,
    manifest, workload,
};
use crate::harness::eventually;

const ROUTER: &str = include_str!("../../../deploy/bgp/router.bird.conf");

fn build(folder: &str) -> Option<String> {
    build_in(&Path::new(FOLDER).join("active-active").join(folder))
}

/// The manifests of these kinds, and all others.
fn split(manifests: &str, group: &str) -> (String, String) {
    let (theirs, known): (Vec<_>, Vec<_>) = manifests
        .split("\n---\n")
        .partition(|document| document.contains(&format!("apiVersion: {group}/")));
    (theirs.join("\n---\n"), known.join("\n---\n"))
}

/// `"15s"` of the configuration.
fn seconds(configuration: &str, key: &str) -> u64 {
    value(configuration, key).trim_matches('"').strip_suffix('s').unwrap().parse().unwrap()
}

fn configuration(manifests: &str) -> String {
    manifest(manifests, "ConfigMap")["data"]["pnet-nat.toml"].as_str().unwrap().to_owned()
}

/// The address that the relays listen on.
fn public_address(manifests: &str) -> String {
    let configuration = configuration(manifests);
    value(&configuration, "listen").trim_matches(['[', ']', '"']).to_owned()
}

#[test]
fn the_relays_are_a_daemonset_that_stops_after_its_address_is_withdrawn() {
    for folder in ["relays", "metallb", "cilium"] {
        let Some(manifests) = build(folder) else { return };
        let workload = workload(&manifests);
        assert_eq!(workload["kind"], "DaemonSet");
        assert_that_one_goes_after_the_other(&workload);
        let pod = &workload["spec"]["template"]["spec"];
        let configuration = configuration(&manifests);
        let [pre_drain, drain] = ["pre_drain", "drain"].map(|key| seconds(&configuration, key));
        assert!(pod["terminationGracePeriodSeconds"].as_u64().unwrap() > pre_drain + drain);
        let probe = &pod["containers"][0]["readinessProbe"];
        let noticed = ["periodSeconds", "failureThreshold"].map(|key| probe[key].as_u64().unwrap());
        assert!(noticed[0] * noticed[1] * 5 <= pre_drain, "it has to be seen in time: {noticed:?}");
        let route = format!("import where net = {}/32;", public_address(&manifests));
        assert!(ROUTER.contains(&route), "{route}");
    }
}

#[test]
fn the_manifests_are_as_the_schemas_want_them() {
    for (folder, group) in [("metallb", "metallb.io"), ("cilium", "cilium.io")] {
        let Some(manifests) = build(folder) else { return };
        let (theirs, known) = split(&manifests, group);
        assert_eq!(theirs.matches("\nkind: ").count(), 4, "{theirs}");
        for version in VERSIONS {
            assert_eq!(complaint(&known, version), None);
            let wrong = known.replace("  updateStrategy:", "  strategy:");
            assert!(complaint(&wrong, version).is_some(), "that is of a Deployment");
        }
        let (daemonset, service) = (workload(&known), manifest(&known, "Service"));
        let labels = &daemonset["spec"]["template"]["metadata"]["labels"];
        let budget = manifest(&known, "PodDisruptionBudget");
        assert_eq!(&service["spec"]["selector"], labels);
        assert_eq!(&budget["spec"]["selector"]["matchLabels"], labels);
        // Its controller knows no number of pods that a percentage or maxUnavailable could refer to.
        assert_eq!(budget["spec"].get("maxUnavailable"), None);
        assert!(budget["spec"]["minAvailable"].as_u64() > Some(0));
        assert_eq!(&daemonset["spec"]["selector"]["matchLabels"], labels);
        assert_eq!(service["spec"]["externalTrafficPolicy"], "Local");
        let namespace = &daemonset["metadata"]["namespace"];
        assert_eq!(&service["metadata"]["namespace"], namespace);
    }
}

/// The numbers of `deploy/bgp`, whose router is the same.
fn assert_the_numbers_of(own: &Value, router: &Value, address: &Value) {
    assert!(ROUTER.contains(&format!("local as {router};")));
    assert!(ROUTER.contains(&format!("as {own}; }}")));
    assert!(ROUTER.contains(&format!("router id {};", address.as_str().unwrap())));
}

#[test]
fn metallb_announces_the_address_of_the_relays() {
    let Some(manifests) = build("metallb") else { return };
    let pod = &workload(&manifests)["spec"]["template"]["spec"];
    let [pool, advertisement, peer, bfd] =
        ["IPAddressPool", "BGPAdvertisement", "BGPPeer", "BFDProfile"]
            .map(|kind| manifest(&manifests, kind));
    for ours in [&pool, &advertisement, &peer, &bfd] {
        assert_eq!(ours["metadata"]["namespace"], "metallb-system");
    }
    assert_eq!(pool["spec"]["addresses"][0], format!("{}/32", public_address(&manifests)));
    let service = manifest(&manifests, "Service");
    let allocation = &pool["spec"]["serviceAllocation"];
    assert_eq!(allocation["namespaces"][0], service["metadata"]["namespace"]);
    assert_eq!(advertisement["spec"]["ipAddressPools"][0], pool["metadata"]["name"]);
    assert_eq!(advertisement["spec"]["peers"][0], peer["metadata"]["name"]);
    let peer = &peer["spec"];
    assert_eq!(peer["bfdProfile"], bfd["metadata"]["name"]);
    assert_eq!(peer["nodeSelectors"][0]["matchLabels"], pod["nodeSelector"]);
    assert_the_numbers_of(&peer["myASN"], &peer["peerASN"], &peer["peerAddress"]);
}

#[test]
fn cilium_announces_the_address_of_the_relays() {
    let Some(manifests) = build("cilium") else { return };
    let pod = &workload(&manifests)["spec"]["template"]["spec"];
    let [pool, cluster, peer, advertisement] = [
        "CiliumLoadBalancerIPPool",
        "CiliumBGPClusterConfig",
        "CiliumBGPPeerConfig",
        "CiliumBGPAdvertisement",
    ]
    .map(|kind| manifest(&manifests, kind));
    for ours in [&pool, &cluster, &peer, &advertisement] {
        assert!(ours["metadata"].get("namespace").is_none(), "it is the cluster's: {ours}");
    }
    assert_eq!(pool["spec"]["blocks"][0]["start"], public_address(&manifests));
    let service = manifest(&manifests, "Service");
    let labels = &service["metadata"]["labels"];
    assert_eq!(&pool["spec"]["serviceSelector"]["matchLabels"], labels);
    let announced = &advertisement["spec"]["advertisements"][0];
    assert_eq!(&announced["selector"]["matchLabels"], labels);
    let family = &peer["spec"]["families"][0];
    assert_eq!(family["advertisements"]["matchLabels"], advertisement["metadata"]["labels"]);
    assert_eq!(cluster["spec"]["nodeSelector"]["matchLabels"], pod["nodeSelector"]);
    let instance = &cluster["spec"]["bgpInstances"][0];
    let router = &instance["peers"][0];
    assert_eq!(router["peerConfigRef"]["name"], peer["metadata"]["name"]);
    assert_the_numbers_of(&instance["localASN"], &router["peerASN"], &router["peerAddress"]);
}

/// The lines of the file, without their `#`.
#[test]
fn kernel_flows_and_monitoring_go_with_it() {
    let none = "  #- ../../kernel-flows\n  - ../daemonset\n  #- ../../monitoring\n";
    let both = none.replace('#', "");
    let Some(manifests) = build_changed("active-active/relays", none, &both) else { return };
    let (_, known) = split(&manifests, "monitoring.coreos.com");
    for version in VERSIONS {
        assert_eq!(complaint(&known, version), None);
    }
    let pod = &workload(&manifests)["spec"]["template"]["spec"];
    assert_eq!(pod["containers"][0]["securityContext"]["runAsUser"], 0);
    let selector = &manifest(&manifests, "Service")["spec"]["selector"];
    let labels = &workload(&manifests)["spec"]["template"]["metadata"]["labels"];
    assert_eq!(selector, labels);
}

/// What the announcer goes by: the probes. The relay still takes requests of clients that are new to it.
#[test]
fn a_relay_that_stops_says_so_and_goes_on() {
    let Some(manifests) = build("relays") else { return };
    let Some(node) = EdgeNode::new(&manifests) else { return };
    let mut container = node.start(&node.configuration);
    node.wait_until_ready(&mut container);
    node.exchange();
    container.process.signal(Signal::SIGTERM);
    eventually("it is not ready", || (node.probe("readinessProbe") == Some(503)).then_some(()));
    assert_eq!(node.probe("livenessProbe"), Some(200));
    node.exchange();
    assert_eq!(container.process.end(), Some(0), "{}", container.process.stderr());
}
