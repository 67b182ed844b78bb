//! USB/IP as in the kernel: requests of 48 bytes, big-endian, and their answers.

use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Mutex, PoisonError};

use super::requests::answer;
use super::state::Shared;

/// Messages: submit and unlink, with their answers.
const SUBMIT: u32 = 1;
const UNLINK: u32 = 2;
const SUBMITTED: u32 = 3;
const UNLINKED: u32 = 4;
/// Size of a message header, bytes.
const HEAD: usize = 48;
/// Maximum length of data sent with a request.
const SENT_MAX: usize = 65_536;
/// Negative Linux errno: stalled request, and unlinked in time.
const REFUSED: i32 = -32;
const TAKEN_BACK: i32 = -104;

/// Sends answers to the driver, for both threads.
#[derive(Clone)]
pub(super) struct Answers(Arc<Mutex<UnixStream>>);

impl Answers {
    pub fn new(stream: UnixStream) -> Answers {
        Answers(Arc::new(Mutex::new(stream)))
    }

    /// `count` is the number of bytes taken or given.
    fn send(&self, message: u32, number: u32, status: i32, given: &[u8], count: usize) -> io::Result<()> {
        let head = [message, number, 0, 0, 0, status as u32, count as u32].map(u32::to_be_bytes);
        let mut bytes = head.as_flattened().to_vec();
        bytes.resize(HEAD, 0);
        bytes.extend(given);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).write_all(&bytes)
    }

    /// Sends picture data to the driver.
    pub fn give(&self, number: u32, given: &[u8]) -> io::Result<()> {
        self.send(SUBMITTED, number, 0, given, given.len())
    }
}

/// Serves the driver until either side closes.
pub(super) fn serve(mut input: UnixStream, answers: &Answers, shared: &Shared, serial: &str) -> io::Result<()> {
    loop {
        let mut head = [0; HEAD];
        match input.read_exact(&mut head) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(()),
            read => read?,
        }
        let word = |i: usize| head[4 * i..].first_chunk().map_or(0, |bytes| u32::from_be_bytes(*bytes));
        let (message, number, is_inward, endpoint, length) =
            (word(0), word(1), word(3) == 1, word(4), word(6) as usize);
        let has_more = message == SUBMIT && !is_inward;
        if has_more && length > SENT_MAX {
            return Err(io::Error::other(format!("the driver sends {length} bytes at once")));
        }
        let mut sent = vec![0; if has_more { length } else { 0 }];
        input.read_exact(&mut sent)?;
        match (message, endpoint) {
            (SUBMIT, 0) => {
                let setup = head[HEAD - 8..].first_chunk().copied().unwrap_or_default();
                let answered = answer(&mut shared.state(), setup, &sent, serial);
                shared.changed.notify_all();
                match answered {
                    Some(mut given) if is_inward => {
                        given.truncate(length);
                        answers.give(number, &given)?;
                    }
                    Some(_) => answers.send(SUBMITTED, number, 0, &[], length)?,
                    None => answers.send(SUBMITTED, number, REFUSED, &[], 0)?,
                }
            }
            (SUBMIT, _) => shared.change(|state| state.requests.push_back((number, length))),
            (UNLINK, _) => {
                let mut state = shared.state();
                state.stops += 1;
                let waiting = state.requests.iter().position(|(waiting, _)| *waiting == word(5));
                let was_waiting = waiting.and_then(|place| state.requests.remove(place)).is_some();
                drop(state);
                shared.changed.notify_all();
                answers.send(UNLINKED, number, if was_waiting { TAKEN_BACK } else { 0 }, &[], 0)?;
            }
            other => return Err(io::Error::other(format!("an unknown message {other:?}"))),
        }
    }
}
