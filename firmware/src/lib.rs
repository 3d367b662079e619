//! ferrocnc-firmware
