//! Arguments of `console`.

use super::{AttendantArgs, InstanceArgs, RunArgs};
use clap::Args;

/// Arguments of `console`: those of `run`, for a group that is started.
#[derive(Debug, Args)]
pub struct ConsoleArgs {
    /// The group.
    #[command(flatten)]
    pub run: RunArgs,
    /// Be the process that serves the page
    #[arg(long, hide = true)]
    pub supervised: bool,
}

impl ConsoleArgs {
    /// The arguments of the process that serves the page.
    pub fn process(self) -> AttendantArgs {
        let instance = InstanceArgs { instance: self.run.instance };
        AttendantArgs { instance, config: self.run.config, supervised: self.supervised }
    }
}
