//! Good clients: each asks as soon as it has its answer, and notes what it waited for in vain.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use pnet_nat::peer::{Client, ExchangeError, Request, Target};
use pnet_nat::pnet::wire::Password;
use tokio::task::JoinSet;

use crate::disturbances::{MIXER, PRESS, PUBLIC, SECTION};
use crate::harness::{PASSWORD, PATIENCE, SECOND};

/// So long, that what has no answer then is lost and not late, however busy the machine.
const WAIT: Duration = PATIENCE;
/// Where a node is down now and then.
const WAIT_FOR_NODE: Duration = Duration::from_secs(3);
/// Where answers stay away for a second at a time.
const SHORT_WAIT: Duration = Duration::from_millis(500);
/// Of those to whom something happens.
pub(crate) const CLIENTS_OF_A_KIND: u64 = 8;
/// Returning clients, each longer away than its flow lasts.
const RETURNING: usize = 64;
const RETURN_INTERVAL: Duration = Duration::from_millis(100);

/// What one kind of clients has seen.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    answered: AtomicU64,
    /// When the latest answer came.
    last_answer: Mutex<Option<Instant>>,
    /// From when to when an answer was waited for in vain.
    lost: Mutex<Vec<Range<Instant>>>,
}

/// All clients, by what happens to them.
#[derive(Debug, Default)]
pub(crate) struct Clients {
    /// Their nodes are up and their password stands: they may lose nothing.
    steady: Arc<Tally>,
    /// The same, one after the other, each on a new flow.
    returning: Arc<Tally>,
    /// Their node loses power now and then.
    pub(crate) restarted: Arc<Tally>,
    /// The operator takes their password from them, and gives it back.
    pub(crate) withdrawn_password: Arc<Tally>,
    /// The operator takes the public port away, and puts it back.
    pub(crate) withdrawn_mapping: Arc<Tally>,
}

impl Clients {
    /// Asks until it is over.
    pub(crate) fn ask(&self, over: &Arc<AtomicBool>) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let mut asking = JoinSet::new();
            let mut begin = |number, start_port, password, node_address, wait, tally: &Arc<_>| {
                for _ in 0..number {
                    let target = target(start_port, password);
                    let (tally, over) = (Arc::clone(tally), Arc::clone(over));
                    asking.spawn(keep_asking(target, node_address, wait, tally, over));
                }
            };
            begin(32, SECTION, PASSWORD, 1, WAIT, &self.steady);
            begin(32, SECTION, PASSWORD, 2, WAIT, &self.steady);
            begin(CLIENTS_OF_A_KIND, MIXER, PASSWORD, 33, WAIT_FOR_NODE, &self.restarted);
            begin(CLIENTS_OF_A_KIND, SECTION, SECOND, 2, SHORT_WAIT, &self.withdrawn_password);
            begin(CLIENTS_OF_A_KIND, SECTION, PASSWORD, 4, SHORT_WAIT, &self.withdrawn_mapping);
            asking.spawn(keep_returning(Arc::clone(&self.returning), Arc::clone(over)));
            while let Some(client) = asking.join_next().await {
                client.unwrap();
            }
        });
    }

    /// Exchanges of all.
    pub(crate) fn answered(&self) -> u64 {
        self.all().map(|(_, tally)| tally.answered()).iter().sum()
    }

    /// Exchanges that were lost though password and mapping stood and the node was up, all the time
    /// that was waited for them.
    pub(crate) fn lost(&self, downtimes: &[Range<Instant>], withdrawals: &[Range<Instant>]) -> u64 {
        [
            self.steady.lost_outside(&[]),
            self.returning.lost_outside(&[]),
            self.restarted.lost_outside(downtimes),
            self.withdrawn_password.lost_outside(withdrawals),
            self.withdrawn_mapping.lost_outside(withdrawals),
        ]
        .iter()
        .sum()
    }

    /// Prints what each kind has seen.
    pub(crate) fn tell(&self) {
        for (kind, tally) in self.all() {
            let lost = tally.lost.lock().unwrap().len();
            println!("{kind}: {} exchanges, {lost} without an answer", tally.answered());
        }
    }

    fn all(&self) -> [(&'static str, &Tally); 5] {
        [
            ("steady clients", &self.steady),
            ("returning clients", &self.returning),
            ("clients of the restarted node", &self.restarted),
            ("clients whose password comes and goes", &self.withdrawn_password),
            ("clients whose public port comes and goes", &self.withdrawn_mapping),
        ]
    }
}

fn target(start_port: u16, password: &[u8; 8]) -> Target {
    Target::new(PUBLIC.into(), start_port, Some(Password::new(*password)))
}

async fn keep_asking(
    target: Target,
    node_address: u8,
    wait: Duration,
    tally: Arc<Tally>,
    over: Arc<AtomicBool>,
) {
    let mut client = Client::bind(target).await.unwrap();
    while !over.load(Relaxed) {
        tally.exchange(&mut client, node_address, wait).await;
    }
}

async fn keep_returning(tally: Arc<Tally>, over: Arc<AtomicBool>) {
    let mut clients = Vec::new();
    for _ in 0..RETURNING {
        clients.push(Client::bind(target(PRESS, PASSWORD)).await.unwrap());
    }
    while !over.load(Relaxed) {
        for client in clients.iter_mut().take_while(|_| !over.load(Relaxed)) {
            tally.exchange(client, 3, WAIT).await;
            tokio::time::sleep(RETURN_INTERVAL).await;
        }
    }
}

impl Tally {
    pub(crate) fn answered(&self) -> u64 {
        self.answered.load(Relaxed)
    }

    pub(crate) fn last_answer(&self) -> Option<Instant> {
        *self.last_answer.lock().unwrap()
    }

    /// What was lost while none of this was the matter.
    fn lost_outside(&self, troubles: &[Range<Instant>]) -> u64 {
        let meets = |waited: &Range<Instant>, trouble: &Range<Instant>| {
            waited.start <= trouble.end && trouble.start <= waited.end
        };
        let excused = |waited: &&Range<Instant>| troubles.iter().any(|t| meets(waited, t));
        self.lost.lock().unwrap().iter().filter(|waited| !excused(waited)).count() as u64
    }

    async fn exchange(&self, client: &mut Client, node_address: u8, wait: Duration) {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let data_octets = &NEXT.fetch_add(1, Relaxed).to_be_bytes();
        let request = Request { node_address, beyond: &[2], control_status: 0x0C, data_octets };
        let sent = Instant::now();
        match client.exchange(&request, wait).await {
            Ok((answer, _)) => {
                assert_eq!(answer.data_octets[..], *data_octets, "an answer to another request");
                self.answered.fetch_add(1, Relaxed);
                *self.last_answer.lock().unwrap() = Some(Instant::now());
            }
            Err(ExchangeError::Lost(_)) => {
                self.lost.lock().unwrap().push(sent..Instant::now());
            }
            Err(error) => panic!("{error}"),
        }
    }
}
