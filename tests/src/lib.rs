//! ferrocnc-tests
