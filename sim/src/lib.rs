//! ferrocnc-sim
