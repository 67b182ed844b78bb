//! Finds the entry of `observed` for each channel of a model.

use isophote_symbolic::{Model, Summand};

/// One summand per channel, in the document's order, with the channel's intensity; or why that is impossible.
pub(crate) fn of_channels(model: &Model) -> Result<Vec<Summand>, String> {
    let channels = model.channels();
    let all = channels.join(", ");
    let mut entries: Vec<Summand> = model.summands().into_iter().filter(|summand| !summand.is_clipped()).collect();
    if let [_] = channels {
        entries.truncate(1);
        return Ok(entries);
    }
    if entries.iter().any(|entry| entry.observed_channel().is_none()) {
        return Err(format!(
            "its `observed` mixes the channels {all}, so that nothing says what each of them reads; write \
             observed = \"[{all}]\" and put the mixing into `intensity`, as models/three-spots-raw.toml does"
        ));
    }
    let of = |(number, name): (usize, &String)| {
        let is = |entry: &&Summand| entry.observed_channel().is_some_and(|channel| channel.index() == number);
        let entry = entries.iter().find(is);
        entry.cloned().ok_or_else(|| {
            format!(
                "nothing says what the channel {name} reads; write observed = \"[{all}]\" with an intensity for each"
            )
        })
    };
    channels.iter().enumerate().map(of).collect()
}
