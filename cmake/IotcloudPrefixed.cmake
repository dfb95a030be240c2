# Runs while `cmake --install` does, with PREFIXED_SOURCE (the project) and PREFIXED_STAGE (a folder for what it makes)
# set: installs files whose paths follow the prefix. They
# are written for the prefix /usr, under which the configuration is in /etc; with another prefix it is in PREFIX/etc. State stays
# below /var/lib, where systemd keeps that of units.
get_filename_component(prefix "${CMAKE_INSTALL_PREFIX}" ABSOLUTE)
string(SHA1 of_prefix "$ENV{DESTDIR}${prefix}")  # two installations at the same time do not write each other's files
string(APPEND PREFIXED_STAGE "/${of_prefix}")
set(etc "${prefix}/etc")
if(prefix STREQUAL "/usr")
  set(etc /etc)
endif()

# Puts SOURCE into PREFIX/DESTINATION, under its own name or another one.
#   CHANGES: pairs of a text that is there and what the installed file has in its place.
function(install_prefixed source destination)
  cmake_parse_arguments(arg "" "NAME" "CHANGES" ${ARGN})
  if(NOT arg_NAME)
    get_filename_component(arg_NAME "${source}" NAME)
  endif()
  file(READ "${PREFIXED_SOURCE}/${source}" text)
  while(arg_CHANGES)
    list(POP_FRONT arg_CHANGES there here)
    string(FIND "${text}" "${there}" place)
    if(place EQUAL -1)
      message(FATAL_ERROR "${source} no longer has \"${there}\", which the installed file has otherwise: see deploy/CMakeLists.txt")
    endif()
    string(REPLACE "${there}" "${here}" text "${text}")
  endwhile()
  foreach(folder bin/iotcloud lib/iotcloud share/doc/iotcloud)
    string(REPLACE "/usr/${folder}" "${prefix}/${folder}" text "${text}")
  endforeach()
  string(REPLACE "/etc/iotcloud" "${etc}/iotcloud" text "${text}")
  set(made "${PREFIXED_STAGE}/${destination}/${arg_NAME}")
  file(WRITE "${made}" "${text}")
  file(INSTALL DESTINATION "${prefix}/${destination}" TYPE FILE FILES "${made}")
endfunction()
