//! Routes designs that nextpnr has placed, and that its own routers take long for or cannot finish
//! because of congestion (decisions 11 and 30).
//!
//! nextpnr places and writes its netlist; this reads it and nextpnr's chip database, routes every
//! net that is not on a clock network, and writes the routes into the netlist; nextpnr reads them,
//! checks every one, reports the frequency of each clock and writes the configuration. A mistake of
//! this router is an error in nextpnr, not a wrong bitstream.

pub mod bel;
pub mod chip;
pub mod netlist;
pub mod route;
pub mod timing;
