#pragma once

#include <functional>
#include <string>
#include <vector>

#include <iotcloud/master/cli/verb.h>

/// Completion of command lines in a shell. The shells' scripts only call this program (`iotcloud __complete WORDS...`),
/// which looks at the options of its verbs, so the scripts never get out of date.
namespace iotcloud::master::cli {

/// Prints the possible completions of the last word, one on each line; the line ":files" alone means any file's name.
/// Prints no error messages.
/// \param words of the command line after the program's name. The user is typing the last one, which may be empty.
/// \param call gets the completions. \param identify sets the credentials for the master; called after `app` has parsed
/// the options that say where the master is. May throw.
/// \return the exit status. May end the process, because it does not wait for a master that does not answer at once.
int answer_shell(CLI::App& app, const std::vector<std::string>& words, Call& call,
                 const std::function<void()>& identify);

}  // namespace iotcloud::master::cli
