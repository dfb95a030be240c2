#pragma once

#include <iosfwd>

#include <iotcloud/master/cli/command.h>
#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

/// `iotcloud describe`: one instance's record, channels and history.
/// All three \throw Ambiguous, Unreachable, Failed. \return the exit status: exit_failed when there is no such
/// instance, or a gateway could not be asked.
int describe(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err);
/// `iotcloud history`: the latest changes of state.
int show_history(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err);
/// `iotcloud logs`: what an instance logs; goes on until interrupted when asked to follow.
int show_logs(const Command& command, MasterClient& master, std::ostream& out);

}  // namespace iotcloud::master::cli
