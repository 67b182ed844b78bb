//! Which formulas say what each plane of a frame reads: those of the entry of `observed` that is the plane's channel.

use std::sync::Arc;

use isophote_symbolic::Model;

/// One model a channel, in the document's order, whose intensity is what the channel reads; else why there are none.
pub(crate) fn of_channels(model: &Arc<Model>) -> Result<Vec<Arc<Model>>, String> {
    let channels = model.channels();
    if let [_] = channels {
        return Ok(vec![model.clone()]);
    }
    let all = channels.join(", ");
    let entries: Vec<Model> =
        model.summands().into_iter().filter(|summand| !summand.is_clipped).map(|summand| summand.model).collect();
    if entries.iter().any(|entry| entry.observed_channel().is_none()) {
        return Err(format!(
            "its `observed` mixes the channels {all}, so that nothing says what each of them reads; write \
             observed = \"[{all}]\" and put the mixing into `intensity`, as models/three-spots-raw.toml does"
        ));
    }
    let of = |(number, name): (usize, &String)| {
        let is = |entry: &&Model| entry.observed_channel().is_some_and(|channel| channel.index() == number);
        let entry = entries.iter().find(is);
        entry.cloned().map(Arc::new).ok_or_else(|| {
            format!(
                "nothing says what the channel {name} reads; write observed = \"[{all}]\" with an intensity for each"
            )
        })
    };
    channels.iter().enumerate().map(of).collect()
}
