//! Which datagram is the response to which request.

use std::net::SocketAddr;
use std::time::Duration;

use super::addresses::Past;
use super::transmit::is_same_port;
use super::{Client, EndpointId, Ignored, Loss, Outcome, Response};
use crate::pnet::wire::{Datagram, Elements, NCNA, Password};

impl Client {
    /// Judges a datagram from `from`, and returns whose request it answers. More segments of that request
    /// may have to be sent yet.
    ///
    /// A datagram that is for a waiting request, but from a wrong port or with a wrong password, tells
    /// later why the request was lost.
    pub fn receive(
        &mut self,
        now: Duration,
        from: SocketAddr,
        octets: &[u8],
    ) -> Result<EndpointId, Ignored> {
        let datagram = Datagram::parse(octets, self.arep.header)?;
        let destinations: Elements = datagram.route().destinations().collect();
        let sources: Elements = datagram.route().sources().collect();
        // A response is unconfirmed (R-34, PAS 6.1.1.1.1.5).
        let &[_, from_node, .., NCNA] = &sources[..] else { return Err(Ignored::NotAResponse) };
        let &[_, _, address] = &destinations[..] else { return Err(Ignored::NotForUs) };
        let id = self.addresses.owner(address)?;
        let index = self.endpoints.iter().position(|(other, _)| *other == id);
        let index = index.ok_or(Ignored::NotForUs)?;
        let endpoint = &mut self.endpoints[index].1;
        let destination = &endpoint.attributes.destination;
        let work = endpoint.work.as_mut().filter(|work| work.tries > 0);
        let work = work.ok_or(Ignored::NotForUs)?;
        if from_node != destination.node.number() {
            return Err(Ignored::NotForUs);
        }
        let way = &destination.way;
        if !is_same_port(from, way.address) {
            work.noticed = Some(Loss::OtherPort(from));
            return Err(Ignored::OtherPort(from));
        }
        if !came_back(way.password.as_ref(), datagram.password()) {
            work.noticed = Some(Loss::WrongPassword);
            return Err(Ignored::WrongPassword);
        }
        self.sources.learn(destination, &destinations);
        let control_status = datagram.control_status();
        if let Err(loss) = work.segments.take(control_status, datagram.data_octets()) {
            self.finish(id, Outcome::Lost(loss), Past::Answered);
            return Ok(id);
        }
        let response = Response {
            destinations,
            sources,
            control_status,
            data_octets: match work.segments.is_complete() {
                true => std::mem::take(&mut work.segments.received),
                false => Vec::new(), // it is not used yet
            },
            round_trip: now.saturating_sub(work.began.unwrap_or(now)),
        };
        self.segment_is_done(index, Outcome::Answered(response));
        Ok(id)
    }
}

/// Whether a response has the password of its request (R-39, PAS 9).
fn came_back(sent: Option<&Password>, came: Option<&[u8; Password::LEN]>) -> bool {
    match (sent, came) {
        (Some(sent), Some(came)) => sent.matches(came).into(),
        (None, None) => true,
        _ => false,
    }
}
