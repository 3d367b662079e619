//! The chip as an `embedded-hal` device, for drivers that run on this computer.

use std::convert::Infallible;
use std::sync::{Arc, Mutex, MutexGuard};

use embedded_hal::spi::{ErrorType, Operation, SpiDevice};

use super::Nor;

/// What a floating output reads: the board has a pull-up.
const FLOATING: u8 = 0xff;

impl ErrorType for Nor {
    type Error = Infallible;
}

impl SpiDevice for Nor {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.select();
        for operation in operations {
            match operation {
                Operation::Read(words) => {
                    for word in words.iter_mut() {
                        *word = self.byte(0).unwrap_or(FLOATING);
                    }
                }
                Operation::Write(words) => {
                    for word in words.iter() {
                        self.byte(*word);
                    }
                }
                Operation::Transfer(read, write) => {
                    for n in 0..read.len().max(write.len()) {
                        let came = self.byte(write.get(n).copied().unwrap_or(0));
                        if let Some(word) = read.get_mut(n) {
                            *word = came.unwrap_or(FLOATING);
                        }
                    }
                }
                Operation::TransferInPlace(words) => {
                    for word in words.iter_mut() {
                        *word = self.byte(*word).unwrap_or(FLOATING);
                    }
                }
                Operation::DelayNs(nanoseconds) => self.pass(u64::from(*nanoseconds)),
            }
        }
        self.deselect(0);
        Ok(())
    }
}

/// A chip that a board and a test share.
#[derive(Clone, Debug)]
pub struct Shared(Arc<Mutex<Nor>>);

impl Shared {
    /// Shares it.
    pub fn new(nor: Nor) -> Self {
        Shared(Arc::new(Mutex::new(nor)))
    }

    /// Locks the chip.
    pub fn chip(&self) -> MutexGuard<'_, Nor> {
        // If a test panicked with the lock held, its panic message is enough.
        self.0
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

impl ErrorType for Shared {
    type Error = Infallible;
}

impl SpiDevice for Shared {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.chip().transaction(operations)
    }
}
