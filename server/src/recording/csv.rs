//! `EstimateTable`: a recording's estimates as a CSV file, one row a target and frame.
//!
//! The columns are those of the first model; after a swap a further head stands in the file where the parameters are others.

use std::fs::File;
use std::io::{BufWriter, Error, Write};

use isophote_symbolic::Model;
use isophote_wire::EstimateView;

/// An open file.
pub struct EstimateTable {
    file: BufWriter<File>,
    parameters: Vec<String>,
}

impl EstimateTable {
    /// An empty file.
    pub fn new(file: File) -> EstimateTable {
        EstimateTable { file: BufWriter::new(file), parameters: Vec::new() }
    }

    /// Estimates of that model follow.
    pub fn begin(&mut self, model: &Model) -> Result<(), Error> {
        let parameters: Vec<String> = model.parameters().iter().map(|parameter| parameter.name.clone()).collect();
        if parameters == self.parameters {
            return Ok(());
        }
        let deviations: Vec<String> = parameters.iter().map(|name| format!("var_{name}")).collect();
        self.parameters = parameters;
        let names = [self.parameters.as_slice(), &deviations].concat().join(",");
        writeln!(self.file, "unix_ns,frame,target,state,model,reduced_chi_square,confidence,saturated,{names}")
    }

    /// One target of one frame; what is not known is empty.
    pub fn row(&mut self, unix_ns: u64, estimate: &EstimateView) -> Result<(), Error> {
        let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let state = serde_json::to_value(estimate.state)?;
        let state = state.as_str().unwrap_or_default();
        let EstimateView { frame, target, model, .. } = estimate;
        write!(self.file, "{unix_ns},{frame},{target},{state},{model}")?;
        for figure in [estimate.reduced_chi_square, estimate.confidence, Some(estimate.saturated)] {
            write!(self.file, ",{}", number(figure))?;
        }
        for name in &self.parameters {
            write!(self.file, ",{}", number(estimate.parameters.get(name)))?;
        }
        for name in &self.parameters {
            let place = estimate.order.iter().position(|free| free == name);
            let variance = place.and_then(|place| estimate.covariance.as_ref()?.get(place)?.get(place).copied());
            write!(self.file, ",{}", number(variance))?;
        }
        writeln!(self.file)
    }

    /// Hands everything to the system.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.file.flush()
    }
}
