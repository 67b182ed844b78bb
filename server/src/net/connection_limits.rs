//! Limits on open connections: in all, and for each address other than this machine's.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::limits::LIMITS;

/// Permits for connections.
pub struct ConnectionLimits {
    sockets: Arc<Semaphore>,
    refusals: Arc<Semaphore>,
    addresses: Arc<Addresses>,
}

type Addresses = Mutex<HashMap<IpAddr, usize>>;

/// Counts one connection until it is dropped.
pub struct ConnectionPermit {
    _socket: OwnedSemaphorePermit,
    _address: Option<AddressPermit>,
}

/// The answer to a new connection.
pub enum Admission {
    /// It is below the limits.
    Granted(ConnectionPermit),
    /// The limit on all connections is reached.
    All,
    /// The limit on connections of its address is reached.
    AllOfAddress,
}

struct AddressPermit {
    addresses: Arc<Addresses>,
    address: IpAddr,
}

impl Default for ConnectionLimits {
    fn default() -> ConnectionLimits {
        ConnectionLimits {
            sockets: Arc::new(Semaphore::new(LIMITS.sockets)),
            refusals: Arc::new(Semaphore::new(LIMITS.sockets_told)),
            addresses: Arc::default(),
        }
    }
}

impl ConnectionLimits {
    /// The permits of all connections, for metrics.
    pub fn sockets(&self) -> Arc<Semaphore> {
        self.sockets.clone()
    }

    /// Admits a connection from an address, or says which limit it exceeds.
    pub fn take(&self, peer: IpAddr) -> Admission {
        let Ok(socket) = self.sockets.clone().try_acquire_owned() else { return Admission::All };
        let peer = peer.to_canonical();
        if peer.is_loopback() {
            return Admission::Granted(ConnectionPermit { _socket: socket, _address: None });
        }
        let address = network(peer);
        let mut taken = self.addresses.lock().unwrap_or_else(PoisonError::into_inner);
        let open = taken.entry(address).or_default();
        if *open >= LIMITS.sockets_per_address {
            return Admission::AllOfAddress;
        }
        *open += 1;
        drop(taken);
        let address = AddressPermit { addresses: self.addresses.clone(), address };
        Admission::Granted(ConnectionPermit { _socket: socket, _address: Some(address) })
    }

    /// Waits for a permit to answer a connection beyond the limits with an error.
    pub async fn refusal(&self) -> Option<ConnectionPermit> {
        self.refusals
            .clone()
            .acquire_owned()
            .await
            .ok()
            .map(|socket| ConnectionPermit { _socket: socket, _address: None })
    }

    /// The same without waiting.
    pub fn try_refusal(&self) -> Option<ConnectionPermit> {
        self.refusals
            .clone()
            .try_acquire_owned()
            .ok()
            .map(|socket| ConnectionPermit { _socket: socket, _address: None })
    }
}

impl Drop for AddressPermit {
    fn drop(&mut self) {
        let mut taken = self.addresses.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(open) = taken.get_mut(&self.address) {
            *open -= 1;
            if *open == 0 {
                taken.remove(&self.address);
            }
        }
    }
}

/// The network that an address counts for: a subscriber usually has 64 bits of IPv6 addresses.
fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() >> 64 << 64).into(),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn connections_of_an_address_are_limited_and_released() {
        let limits = ConnectionLimits::default();
        let take = |address: &str| match limits.take(address.parse().unwrap()) {
            Admission::Granted(permit) => Some(permit),
            Admission::All | Admission::AllOfAddress => None,
        };
        let mut held: Vec<ConnectionPermit> =
            (0..LIMITS.sockets_per_address).map(|_| take("192.0.2.1").unwrap()).collect();
        assert!(take("192.0.2.1").is_none() && take("::ffff:192.0.2.1").is_none());
        held.push(take("192.0.2.2").unwrap());
        drop(held.remove(0));
        held.push(take("192.0.2.1").unwrap());
        let of_a_network = (0..LIMITS.sockets_per_address).map(|n| take(&format!("2001:db8::{n:x}")).unwrap());
        held.extend(of_a_network);
        assert!(take("2001:db8::ffff:1").is_none());
        held.push(take("2001:db8:0:1::1").unwrap());
        let own = LIMITS.sockets - held.len();
        held.extend((0..own).map(|_| take("127.0.0.1").unwrap()));
        assert!(matches!(limits.take("127.0.0.1".parse().unwrap()), Admission::All));
        drop(held);
        assert!(limits.addresses.lock().unwrap().is_empty());
    }
}
