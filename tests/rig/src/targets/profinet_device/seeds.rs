//! Where the fuzzer begins: a client that reads, in one piece and in fragments, from each port of the
//! device, and what else there is, one thing in each file.

/// Names of files of the corpus, and what is in them.
pub fn all() -> Vec<(String, Vec<u8>)> {
    let mut seeds = Vec::new();
    let mut put = |name: String, steps: &[&[u8]]| {
        seeds.push((format!("seed-{name}"), [&[0], &steps.concat()[..]].concat()));
    };
    for port in 0..5 {
        let read = request(0, &[0, 0]);
        let ping = request(0, &[6, 0, 1]);
        put(
            format!("port-{port}"),
            &[&read, &response(port, &[0, 0]), &ping, &response(port, &[3, 0, 4])],
        );
    }
    for index in 0..8 {
        put(
            format!("index-{index}"),
            &[&request(0, &[0, index << 5]), &request(1, &[0, index << 5 | 0x10])],
        );
    }
    for (size, pieces) in [(0, 3), (1, 2), (2, 2), (3, 2), (4, 4), (5, 3)] {
        let of_order = |order: u8| {
            let piece = |number| request(0, &[3, order, size, number]);
            (0..pieces).flat_map(piece).collect::<Vec<_>>()
        };
        let answer = response(1, &[2, 0, 0]);
        put(format!("fragments-{size}"), &[&of_order(0), &answer, &of_order(0x14), &answer]);
    }
    let first = request(0, &[3, 0, 5, 0]);
    let others: Vec<_> = (1..3).flat_map(|number| request(0, &[3, 0, 5 | 0x80, number])).collect();
    put("two-orders".into(), &[&first, &others]);
    put("nothing".into(), &[&request(0, &[0, 0]), &request(0, &[3, 0, 0, 3])]);
    for operation in [0, 1, 2, 3, 4, 6, 7] {
        put(format!("operation-{operation}"), &[&request(0, &[7, 0, 0, operation])]);
    }
    for packet_type in 0..11 {
        let read = request(0, &[0, 0]);
        let there = request(0, &[6, 0, packet_type]);
        put(format!("type-{packet_type}"), &[&read, &there, &response(1, &[3, 0, packet_type])]);
    }
    let look_ups = [0, 1, 2].map(|kind| request(2, &[5, 0, kind]));
    put("look-ups".into(), &[&look_ups.concat(), &response(0, &[0, 0])]);
    let damaged = request(0, &[0x18, 0, 1, 101, 8]);
    put(
        "damaged".into(),
        &[&damaged, &request(0, &[0x18, 0, 130]), &request(0, &[0xF8, 5, 1, 2, 3, 4, 5])],
    );
    let everybody = [0, 1, 2, 3, 4].map(|client| request(client, &[0, client])).concat();
    put("everybody".into(), &[&everybody, &response(0, &[0, 0]), &response(1, &[0, 0])]);
    // Other records, fewer clients; then a pause of ten seconds, and one of three minutes.
    for variant in [1, 2, 4, 6, 8, 16, 32] {
        let reload = [244, variant];
        let answer = response(1, &[0, 0]);
        put(
            format!("reload-{variant}"),
            &[&everybody, &reload, &answer, &everybody, &[240], &answer],
        );
    }
    for (name, pause) in [("short", [208, 2, 2]), ("long", [208, 3, 3])] {
        let answer = response(1, &[0, 0]);
        put(format!("pause-{name}"), &[&everybody, &pause, &answer, &everybody, &answer]);
    }
    put("no-sockets".into(), &[&[236, 1], &everybody]);
    seeds
}

/// A client's datagram; it is sent.
fn request(client: u8, datagram: &[u8]) -> Vec<u8> {
    [&[0, client, 0], datagram, &[0]].concat()
}

/// What the device sends from a port about the first call.
fn response(port: u8, datagram: &[u8]) -> Vec<u8> {
    [&[128, 0, 0, port], datagram, &[0]].concat()
}
