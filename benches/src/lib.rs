//! isophote
