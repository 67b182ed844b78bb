//! kill −9 during changes, repeatedly: `cargo run --release -p isophote-tests --example kills -- 1000 [SEED]`. Stops at
//! the first acknowledged change that is lost; otherwise prints the tally.

#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // prints its findings, and uses half of the tests' client

#[path = "../tests/service/client.rs"]
mod client;
#[path = "../tests/service/killing.rs"]
mod killing;

fn main() {
    let mut arguments = std::env::args().skip(1).map(|argument| argument.parse::<u64>().unwrap());
    let (kills, seed) = (arguments.next().unwrap_or(1000), arguments.next().unwrap_or(20_261_123));
    let folder = client::Folder::new("kills-many");
    let tally = killing::kill(&isophote_tests::program().unwrap(), &folder.0, kills as usize, seed);
    println!("{kills} kills, seed {seed}: {tally:?}; nothing torn, nothing lost, what is declared runs");
}
