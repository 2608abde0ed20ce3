//! `touchline setup-worker`: one request of the console about setting up, read from standard input.

use super::CommandError;
use super::group::running;
use crate::cli::SetupWorkerArgs;
use std::io::Read;
use std::process::ExitCode;
use touchline::setup_worker::{Kind, answer, refusal};

/// Longest request.
const MOST_BYTES: u64 = 1 << 20;

/// Answers on standard output; a refusal is an answer too, with exit code 1.
pub fn work(args: SetupWorkerArgs) -> Result<ExitCode, CommandError> {
    let kind = Kind::from_name(&args.kind).ok_or_else(|| {
        let names: Vec<&str> = Kind::ALL.iter().map(|kind| kind.name()).collect();
        format!("{:?}: the kinds are {}", args.kind, names.join(", "))
    })?;
    let instance = running(&args.instance)?;
    let mut request = Vec::new();
    std::io::stdin().take(MOST_BYTES).read_to_end(&mut request)?;
    match answer(kind, &request, &instance) {
        Ok(answer) => {
            runtime::say_line!("{answer}")?;
            Ok(ExitCode::SUCCESS)
        }
        Err(error) => {
            runtime::say_line!("{}", refusal(&error))?;
            Ok(ExitCode::FAILURE)
        }
    }
}
