//! litex-pac
