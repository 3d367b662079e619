//! Notes what each step cost: its seconds, and the seconds of a core that it and its children took.
//! With two cores and three queues the first says what else ran; the second is what a step is paid
//! with.

use std::sync::{Mutex, PoisonError};

/// What one step cost.
#[derive(Clone, Debug)]
pub struct Cost {
    /// The name of its log.
    pub step: String,
    /// From its start to its end.
    pub seconds: f32,
    /// User and system time of the command and of every child that was waited for.
    pub core_seconds: f32,
}

/// The steps of this run so far.
static STEPS: Mutex<Vec<Cost>> = Mutex::new(Vec::new());

/// Takes note of a step.
pub fn note(step: &str, seconds: f32, core_seconds: f32) {
    let mut steps = STEPS.lock().unwrap_or_else(PoisonError::into_inner);
    steps.push(Cost {
        step: step.to_owned(),
        seconds,
        core_seconds,
    });
}

/// All steps so far, the dearest first.
pub fn dearest() -> Vec<Cost> {
    let mut steps = STEPS.lock().unwrap_or_else(PoisonError::into_inner).clone();
    steps.sort_by(|a, b| b.core_seconds.total_cmp(&a.core_seconds));
    steps
}
