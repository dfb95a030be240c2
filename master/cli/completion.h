#pragma once

#include <functional>
#include <iosfwd>
#include <string>
#include <vector>

#include <iotcloud/master/cli/arguments.h>

/// What a shell completes. The scripts only ask this program (`iotcloud __complete WORDS...`), which looks at its own
/// options and verbs, so that they cannot grow stale.
namespace iotcloud::master::cli {

/// The verb that prints the script for a shell into `words.shell`.
void add_completion(CLI::App& app, Words& words);
/// \return the exit status.
int print_completion(const std::string& shell, std::ostream& out);

/// What can stand in the place of the last word, one a line; ":files" alone: a file's name. Never complains.
/// \param words of the command line behind the program's name; the last one is being written and may be empty.
/// \param command called after the options that say where the master is were parsed by `app`: what they make. May
/// throw.
/// \return the exit status. May end the process: a master that does not answer at once is not waited for.
int answer_shell(CLI::App& app, const std::vector<std::string>& words, const std::function<Command()>& command);

}  // namespace iotcloud::master::cli
