//! Who finds a place: so many connections in all, and so many of one address that is not this machine's.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::limits::LIMITS;

/// All places.
pub struct SocketPlaces {
    sockets: Arc<Semaphore>,
    told: Arc<Semaphore>,
    addresses: Arc<Addresses>,
}

type Addresses = Mutex<HashMap<IpAddr, usize>>;

/// A connection's; free again when it is dropped.
pub struct SocketPlace {
    _socket: OwnedSemaphorePermit,
    _address: Option<AddressPlace>,
}

/// Whether there was a place.
pub enum SocketTaken {
    /// There was.
    Place(SocketPlace),
    /// All are taken.
    All,
    /// All that this address may have.
    AllOfAddress,
}

struct AddressPlace {
    addresses: Arc<Addresses>,
    address: IpAddr,
}

impl Default for SocketPlaces {
    fn default() -> SocketPlaces {
        SocketPlaces {
            sockets: Arc::new(Semaphore::new(LIMITS.sockets)),
            told: Arc::new(Semaphore::new(LIMITS.sockets_told)),
            addresses: Arc::default(),
        }
    }
}

impl SocketPlaces {
    /// Those of all connections, to be counted.
    pub fn sockets(&self) -> Arc<Semaphore> {
        self.sockets.clone()
    }

    /// One for a connection from there.
    pub fn take(&self, peer: IpAddr) -> SocketTaken {
        let Ok(socket) = self.sockets.clone().try_acquire_owned() else { return SocketTaken::All };
        let peer = peer.to_canonical();
        if peer.is_loopback() {
            return SocketTaken::Place(SocketPlace { _socket: socket, _address: None });
        }
        let address = network(peer);
        let mut taken = self.addresses.lock().unwrap_or_else(PoisonError::into_inner);
        let places = taken.entry(address).or_default();
        if *places >= LIMITS.sockets_per_address {
            return SocketTaken::AllOfAddress;
        }
        *places += 1;
        drop(taken);
        let address = AddressPlace { addresses: self.addresses.clone(), address };
        SocketTaken::Place(SocketPlace { _socket: socket, _address: Some(address) })
    }

    /// One for a connection that is told that there is none, when there is one.
    pub async fn told(&self) -> Option<SocketPlace> {
        self.told.clone().acquire_owned().await.ok().map(|socket| SocketPlace { _socket: socket, _address: None })
    }

    /// The same, if there is one now.
    pub fn try_told(&self) -> Option<SocketPlace> {
        self.told.clone().try_acquire_owned().ok().map(|socket| SocketPlace { _socket: socket, _address: None })
    }
}

impl Drop for AddressPlace {
    fn drop(&mut self) {
        let mut taken = self.addresses.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(places) = taken.get_mut(&self.address) {
            *places -= 1;
            if *places == 0 {
                taken.remove(&self.address);
            }
        }
    }
}

/// A household has 64 bits of addresses.
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
    fn one_address_takes_no_more_than_its_share_and_gives_it_back() {
        let places = SocketPlaces::default();
        let take = |address: &str| match places.take(address.parse().unwrap()) {
            SocketTaken::Place(place) => Some(place),
            SocketTaken::All | SocketTaken::AllOfAddress => None,
        };
        let mut held: Vec<SocketPlace> = (0..LIMITS.sockets_per_address).map(|_| take("192.0.2.1").unwrap()).collect();
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
        assert!(matches!(places.take("127.0.0.1".parse().unwrap()), SocketTaken::All));
        drop(held);
        assert!(places.addresses.lock().unwrap().is_empty());
    }
}
