//! A server node: which datagrams it takes, and what its responses look like.

use std::net::SocketAddrV4;
use std::time::Duration;

use super::DynamicClients;
use super::client::{ArepRole, RepRole};
use crate::pnet::ip_net_table::{IpNetTable, Sender};
use crate::pnet::wire::{
    BNA, Datagram, DatagramError, DatagramRepr, DlRoute, DlRouteError, Elements, EmitError, Header,
    Indication, IpNetId, NCNA, NodeAddress, Password, RouteBuf, SNA,
};

/// The port that a datagram came to (R-1, R-2, PAS 7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Port {
    /// It takes packages with and without a password.
    Normal,
    /// It takes only packages with a password that the server knows.
    Secure,
}

/// Why a server takes no notice of a datagram, in the order of the checks. It answers none of them
/// (A10).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Ignored {
    /// The octets are no P-NET datagram.
    #[error("{0}")]
    NotADatagram(#[from] DatagramError),
    /// The route is none of a request over IP: it names no IPNetID (A6), or the datagram is an
    /// acknowledgement or an immediate reply of a half-duplex bus (R-32, PAS 5.4.1.1).
    #[error("a route that is not for IP")]
    NotOnIp,
    /// Its node address is another one (R-33, PAS 5.4.1.2 a).
    #[error("for another node")]
    OtherNode,
    /// There is no password, and the Secure port needs one (R-3, PAS 7).
    #[error("no password at the Secure port")]
    NoPassword,
    /// The server does not know the password (R-7, PAS 7).
    #[error("a wrong password")]
    WrongPassword,
    /// No route back to the client can be formed.
    #[error("no route back: {0}")]
    NoWayBack(#[from] DlRouteError),
}

/// A request that a server takes (R-28, PAS 5.7.1.6).
#[derive(Clone, Debug)]
pub struct Indicated<'a> {
    /// Who waits for a response. `None` for an unconfirmed request, such as a broadcast or the
    /// response of another server: it gets none.
    pub requester: Option<Requester>,
    /// What the route names behind the server: ports and node addresses.
    pub beyond: Elements,
    /// The control-status. The standard does not give its codes.
    pub control_status: u8,
    /// The data, at most 63 octets.
    pub data_octets: &'a [u8],
}

/// The way back to the client of a confirmed request.
#[derive(Clone, Debug)]
pub struct Requester {
    address: SocketAddrV4,
    header: Header,
    route: RouteBuf,
    control_status: u8,
    data_field_flags: u8,
    password: Option<Password>,
}

impl Requester {
    /// Where the response goes. It leaves from the port that the request came to (A14).
    pub fn address(&self) -> SocketAddrV4 {
        self.address
    }

    /// Writes the response with these data, and returns its length in octets. A buffer of
    /// [`MAX_DATAGRAM`](crate::pnet::wire::MAX_DATAGRAM) octets is always large enough.
    ///
    /// The response is unconfirmed, has the control-status of the request, and the password
    /// that the client used. Fails for more than 63 data octets and for a buffer that is too
    /// small.
    pub fn respond(&self, data_octets: &[u8], octets: &mut [u8]) -> Result<usize, EmitError> {
        DatagramRepr {
            header: self.header,
            route: self.route.as_route(),
            control_status: self.control_status,
            data_field_flags: self.data_field_flags,
            data_octets,
            password: self.password.clone(),
        }
        .emit(octets)
    }

    /// The same client, but its response has another password than the request: to try out what a
    /// client does about it.
    #[must_use]
    pub fn with_wrong_password(self) -> Self {
        let wrong = |password: Password| Password::new(password.octets().map(|octet| !octet));
        Self { password: self.password.map(wrong), ..self }
    }
}

/// A server node with its IPNetTable, its passwords, and its dynamic clients.
#[derive(Clone, Debug)]
pub struct Server {
    table: IpNetTable,
    header: Header,
    passwords: Vec<Password>,
    dynamic_clients: DynamicClients,
}

impl Server {
    /// A server that is the node of this table. `header` is that of every datagram. Any of the
    /// passwords opens the Secure port; without one, nothing does.
    pub fn new(table: IpNetTable, header: Header, passwords: Vec<Password>) -> Self {
        Self { table, header, passwords, dynamic_clients: DynamicClients::default() }
    }

    /// The server's node address.
    pub fn node_address(&self) -> NodeAddress {
        self.table.node_address()
    }

    /// The role of its Route Endpoint (PAS 6.1.1.1.1.2).
    pub fn role(&self) -> RepRole {
        RepRole::RealContainer
    }

    /// The role of the endpoint that requests come to (PAS 6.1.1.2.1.3).
    pub fn arep_role(&self) -> ArepRole {
        ArepRole::Server
    }

    /// The clients that the table does not know, as they are now.
    pub fn dynamic_clients(&self) -> &DynamicClients {
        &self.dynamic_clients
    }

    /// Judges a datagram from `from`. `now` is the time since any moment that stays the same.
    ///
    /// A client that the table does not know gets a place among the dynamic clients only once its
    /// datagram has passed all checks. So nobody without a password takes a place at the Secure
    /// port (A13).
    pub fn receive<'a>(
        &mut self,
        now: Duration,
        port: Port,
        from: SocketAddrV4,
        octets: &'a [u8],
    ) -> Result<Indicated<'a>, Ignored> {
        let datagram = Datagram::parse(octets, self.header)?;
        let indication = Indication::parse(&datagram).ok_or(Ignored::NotOnIp)?;
        let node_address = datagram.route().node_address().ok_or(Ignored::NotOnIp)?;
        if !self.is_for_us(node_address) {
            return Err(Ignored::OtherNode);
        }
        self.check_password(port, datagram.password())?;
        let requester = match indication.confirm {
            true => Some(self.requester(now, from, &datagram, &indication.dl_route)?),
            false => None,
        };
        Ok(Indicated {
            requester,
            beyond: indication.dl_route.destination,
            control_status: indication.control_status,
            data_octets: indication.dlsdu,
        })
    }

    /// R-33, PAS 5.4.1.2 a.
    fn is_for_us(&self, number: u8) -> bool {
        number == self.node_address().get() || number == BNA || number == SNA
    }

    fn check_password(
        &self,
        port: Port,
        password: Option<&[u8; Password::LEN]>,
    ) -> Result<(), Ignored> {
        match (port, password) {
            (Port::Normal, _) => Ok(()),
            (Port::Secure, None) => Err(Ignored::NoPassword),
            (Port::Secure, Some(octets)) => {
                // All are compared, so that the time does not tell which one it was.
                let matches = self
                    .passwords
                    .iter()
                    .fold(0, |matches, password| matches | password.matches(octets).unwrap_u8());
                if matches == 1 { Ok(()) } else { Err(Ignored::WrongPassword) }
            }
        }
    }

    /// The way back to a client: through the table, or through net 125 (R-35 to R-39, PAS 9).
    fn requester(
        &mut self,
        now: Duration,
        from: SocketAddrV4,
        datagram: &Datagram<'_>,
        indicated: &DlRoute,
    ) -> Result<Requester, Ignored> {
        let repr = DatagramRepr::parse(datagram);
        let ip_net_id = datagram.route().ip_net_id();
        let mut client = indicated.source.clone();
        let mut route = self.route_back(ip_net_id, &client, &indicated.destination)?;
        if let [net, node_address, ..] = &mut client[..]
            && !self.knows(from, (*net, *node_address), repr.password.is_some())
        {
            *net = IpNetId::DYNAMIC_CLIENTS.get();
            *node_address = self.dynamic_clients.note(now, from, repr.password.clone()).get();
            route = self.route_back(ip_net_id, &client, &indicated.destination)?;
        }
        Ok(Requester {
            address: from,
            header: self.header,
            route,
            control_status: repr.control_status,
            data_field_flags: repr.data_field_flags,
            password: repr.password,
        })
    }

    /// The response to a known client goes where the table says, which is where the
    /// request came from.
    fn knows(&self, from: SocketAddrV4, (net, node): (u8, u8), has_password: bool) -> bool {
        let (Some(net), Some(node_address)) = (IpNetId::new(net), NodeAddress::new(node)) else {
            return false;
        };
        self.table.is_known_client(&Sender { net, node_address, address: from, has_password })
    }

    /// The route of the response: the way to the client, then the way to the responder, with the
    /// server's own address in front (R-27, PAS 5.7.1.5). Its IPNetID is the one by which the
    /// client knows the server. NCNA comes last: a response is unconfirmed.
    fn route_back(
        &self,
        ip_net_id: Option<u8>,
        client: &[u8],
        beyond: &[u8],
    ) -> Result<RouteBuf, DlRouteError> {
        let mut responder: Elements = beyond.iter().copied().collect();
        responder.try_push(NCNA).map_err(|_| DlRouteError::TooLong(beyond.len() + 1))?;
        DlRoute::new(client, &responder)?.sent_by(ip_net_id, self.node_address().get())?.to_route()
    }
}
