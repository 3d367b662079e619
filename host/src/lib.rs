//! ferrocnc
