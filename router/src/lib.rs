//! Routes what nextpnr has placed, where nextpnr's routers end in congestion (decision 11).
//!
//! nextpnr places and writes its netlist; this reads it and nextpnr's chip database, routes every net that is not on a clock network,
//! and writes the routes into the netlist; nextpnr reads them, looks over every one, says what the clocks reach and writes the
//! configuration. What is wrong here is an error there, not a wrong bitstream.

pub mod chip;
pub mod netlist;
pub mod route;
pub mod timing;
