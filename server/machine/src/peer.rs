//! The progress of a TCP connection's peer, from the kernel's counters.

#![allow(unsafe_code)] // each block states its proof

use std::os::fd::AsFd;

/// The kernel's counters of a connection's peer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PeerProgress {
    /// Bytes that were written to the socket and not sent yet.
    pub unsent_bytes: u64,
    /// Whether all that was sent is acknowledged.
    pub is_acknowledged: bool,
    /// Bytes that the peer has acknowledged since the connection began.
    pub acknowledged_bytes: u64,
    /// The peer's receive window as of its last acknowledgement: narrower the more its program has not read.
    pub window_bytes: u64,
    /// The window is a multiple of so many bytes.
    pub window_step_bytes: u64,
}

impl PeerProgress {
    /// Of a connected TCP socket; `None` if the system does not report it (Linux does from 5.4 on).
    #[cfg(target_os = "linux")]
    pub fn of(socket: impl AsFd) -> Option<PeerProgress> {
        use std::mem::{offset_of, size_of, zeroed};
        use std::os::fd::AsRawFd;

        // SAFETY: `tcp_info` is a C structure of integers, for which zeros are values.
        let mut info: libc::tcp_info = unsafe { zeroed() };
        let mut length = size_of::<libc::tcp_info>() as libc::socklen_t;
        let socket = socket.as_fd();
        // SAFETY: the borrowed descriptor is open, and the system writes no more than `length` bytes to `info`.
        let status = unsafe {
            let (value, length) = ((&raw mut info).cast(), &raw mut length);
            libc::getsockopt(socket.as_raw_fd(), libc::IPPROTO_TCP, libc::TCP_INFO, value, length)
        };
        // Older systems have fewer fields.
        let needed = offset_of!(libc::tcp_info, tcpi_snd_wnd) + size_of::<u32>();
        (status == 0 && length as usize >= needed).then(|| PeerProgress {
            unsent_bytes: info.tcpi_notsent_bytes.into(),
            is_acknowledged: info.tcpi_unacked == 0,
            acknowledged_bytes: info.tcpi_bytes_acked,
            window_bytes: info.tcpi_snd_wnd.into(),
            window_step_bytes: 1 << (info.tcpi_snd_rcv_wscale & 0xf),
        })
    }

    /// Of a connected TCP socket; `None` if the system does not report it.
    #[cfg(not(target_os = "linux"))]
    pub fn of(_socket: impl AsFd) -> Option<PeerProgress> {
        None
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::io::{Read, Write};
    use std::net::{TcpListener, TcpStream};

    use super::*;

    #[test]
    fn unread_bytes_narrow_the_window() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut reader = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (mut writer, _) = listener.accept().unwrap();
        let settled = |writer: &TcpStream| loop {
            let now = PeerProgress::of(writer).unwrap();
            if now.is_acknowledged {
                return now;
            }
            std::thread::yield_now();
        };
        let begin = settled(&writer);
        writer.set_nonblocking(true).unwrap();
        let mut written = 0;
        while let Ok(bytes) = writer.write(&[7; 4096]) {
            written += bytes;
        }
        let full = settled(&writer);
        assert!(full.unsent_bytes > 0 && full.window_bytes < begin.window_bytes / 2, "{begin:?} {full:?}");
        assert_eq!(full.acknowledged_bytes - begin.acknowledged_bytes, written as u64 - full.unsent_bytes);
        let mut all = vec![0; written];
        reader.read_exact(&mut all).unwrap();
        writer.write_all(&[7]).unwrap();
        let read = settled(&writer);
        assert!(read.unsent_bytes == 0 && read.window_bytes > full.window_bytes, "{full:?} {read:?}");
        assert_eq!(PeerProgress::of(std::io::stderr()), None, "no socket");
    }
}
