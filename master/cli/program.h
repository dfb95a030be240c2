#pragma once

#include <string>
#include <vector>

#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

/// The program `iotcloud`: reads the command line, and runs its verb. \param words of the command line, without the
/// program's name. \param call gets the options that the words set. \return the exit status
int run_program(const std::vector<std::string>& words, Call& call);

}  // namespace iotcloud::master::cli
