//! `EstimateTable`: a recording's estimates as a CSV file, one row per target and frame.
//!
//! If a swap changes the parameters, another header row follows in the file.

use std::fs::File;
use std::io::{BufWriter, Error, Write};

use isophote_symbolic::Model;
use isophote_wire::EstimateView;

/// An open CSV file.
pub struct EstimateTable {
    file: BufWriter<File>,
    parameters: Vec<String>,
    waiting_bytes: u64,
}

impl EstimateTable {
    /// A table in an empty file.
    pub fn new(file: File) -> EstimateTable {
        EstimateTable { file: BufWriter::new(file), parameters: Vec::new(), waiting_bytes: 0 }
    }

    /// Writes a header row if the model's parameters are other than before.
    pub fn begin(&mut self, model: &Model) -> Result<(), Error> {
        let parameters: Vec<String> = model.parameters().iter().map(|parameter| parameter.name.clone()).collect();
        if parameters == self.parameters {
            return Ok(());
        }
        let deviations: Vec<String> = parameters.iter().map(|name| format!("var_{name}")).collect();
        self.parameters = parameters;
        let names = [self.parameters.as_slice(), &deviations].concat().join(",");
        self.line(&format!("unix_ns,frame,target,state,model,reduced_chi_square,confidence,saturated,{names}"))
    }

    /// Writes one target of one frame; unknown values are empty.
    pub fn row(&mut self, unix_ns: u64, estimate: &EstimateView) -> Result<(), Error> {
        let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let state = serde_json::to_value(estimate.state)?;
        let state = state.as_str().unwrap_or_default();
        let EstimateView { frame, target, model, .. } = estimate;
        let figures = [estimate.reduced_chi_square, estimate.confidence, Some(estimate.saturated)];
        let values = self.parameters.iter().map(|name| estimate.parameters.get(name));
        let variances = self.parameters.iter().map(|name| {
            let place = estimate.order.iter().position(|free| free == name)?;
            estimate.covariance.as_ref()?.get(place)?.get(place).copied()
        });
        let cells: Vec<String> = figures.into_iter().chain(values).chain(variances).map(number).collect();
        self.line(&format!("{unix_ns},{frame},{target},{state},{model},{}", cells.join(",")))
    }

    fn line(&mut self, text: &str) -> Result<(), Error> {
        self.waiting_bytes += text.len() as u64 + 1;
        writeln!(self.file, "{text}")
    }

    /// Bytes written since the last flush.
    pub fn waiting_bytes(&self) -> u64 {
        self.waiting_bytes
    }

    /// Flushes to the system; returns the file's bytes.
    pub fn flush(&mut self) -> Result<u64, Error> {
        self.file.flush()?;
        self.waiting_bytes = 0;
        Ok(self.file.get_ref().metadata()?.len())
    }
}
