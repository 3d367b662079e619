//! What the application keeps outside of the stack.

use firmware::ip::Ip;

/// The data that is too large for the stack. There is one of it, in `.bss`.
pub struct Memory {
    /// TCP for the console.
    pub ip: Ip,
}

impl Memory {
    /// The initial state.
    pub const fn new() -> Self {
        Memory { ip: Ip::new() }
    }
}
