//! The rule of the fast path, on a board that executes with a pass as the gateware does.
use super::*;
