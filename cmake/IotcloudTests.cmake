# One function for each kind of test, and targets that build what tests need.

# The tests are compiled fast instead of optimized, in every preset, because they examine the product.
function(_iotcloud_test_code target)
  target_compile_options(${target} PRIVATE -O0)
endfunction()

# A test's labels: what it needs (`unit`, `contract`, `server`, `system`, `long`; tests/README.md), `room:` and its room,
# which is its folder (below tests/; one of them is named as a kind is), and the presets under which ./dev test runs it:
# `release`, `asan`, `tsan`. ./dev test runs a
# unit or contract test once: under tsan, under asan, or in release if neither has anything to find. Those that asan runs
# besides tsan have the label `asan_long`, for ./dev test --long. With LATER ./dev test runs the test in release, and --long
# under its sanitizers (`asan_long`, `tsan_long`). A test whose subject is OPTIMIZED further in release runs under all its
# presets.
function(_iotcloud_test_labels out)
  cmake_parse_arguments(arg "OPTIMIZED;LATER" "" "LABELS;SANITIZERS" ${ARGN})
  set(presets ${arg_SANITIZERS})
  if(arg_LATER)
    list(TRANSFORM presets APPEND _long)
  elseif(tsan IN_LIST presets AND NOT arg_OPTIMIZED)
    list(TRANSFORM presets REPLACE "^asan$" asan_long)
  endif()
  if(NOT arg_LABELS MATCHES "^(unit|contract)" OR NOT arg_SANITIZERS OR arg_OPTIMIZED OR arg_LATER)
    list(PREPEND presets release)
  endif()
  list(POP_FRONT arg_LABELS kind)
  if(NOT kind MATCHES "^(unit|contract|server|system|long)$")
    message(FATAL_ERROR "a test is labelled unit, contract, server, system or long, not \"${kind}\"")
  endif()
  file(RELATIVE_PATH room ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
  string(REGEX REPLACE "^tests/" "" room ${room})
  string(REGEX REPLACE "/.*" "" room ${room})
  set(${out} ${kind} room:${room} ${arg_LABELS} ${presets} PARENT_SCOPE)
endfunction()

# What ./dev test reads before it builds anything (development/choose.py): a line for each test, or for each program whose
# tests only its sources name: NAME, "test" or "program", labels, targets, sources, and what is missing here for it.
function(_iotcloud_list_test)
  cmake_parse_arguments(arg "" "NAME;HOW;MISSING" "LABELS;TARGETS;SOURCES" ${ARGN})
  set(sources)
  foreach(source ${arg_SOURCES})
    get_filename_component(source ${source} ABSOLUTE)
    list(APPEND sources ${source})
  endforeach()
  set(arg_SOURCES ${sources})
  foreach(what LABELS TARGETS SOURCES)
    list(JOIN arg_${what} " " arg_${what})
  endforeach()
  set_property(GLOBAL APPEND_STRING PROPERTY IOTCLOUD_TESTS
               "${arg_NAME}\t${arg_HOW}\t${arg_LABELS}\t${arg_TARGETS}\t${arg_SOURCES}\t${arg_MISSING}\n")
endfunction()

# A test, or a program of tests, that cannot be built here because something is MISSING. ./dev test installs what its labels
# say when the test is asked for; one that is still left out is told in the summary, and fails where CI=true.
#   iotcloud_left_out(NAME ros_turtle_test MISSING "it needs roscpp" LABELS server ros [SOURCES ros_turtle_test.cc])
function(iotcloud_left_out)
  cmake_parse_arguments(arg "" "NAME;MISSING" "LABELS;SOURCES" ${ARGN})
  _iotcloud_test_labels(labels LABELS ${arg_LABELS})
  set(how test)
  if(arg_SOURCES)
    set(how program)
  endif()
  _iotcloud_list_test(NAME ${arg_NAME} HOW ${how} LABELS ${labels} SOURCES ${arg_SOURCES} MISSING ${arg_MISSING})
endfunction()

# `java` if the word names a server that runs on Java.
function(_iotcloud_java_label out word)
  set(${out} "" PARENT_SCOPE)
  if(word MATCHES "[Kk]afka|[Aa]ctive[Mm][Qq]")
    set(${out} java PARENT_SCOPE)
  endif()
endfunction()

# The target tested_all builds the tests that ./dev test runs under the preset. ./dev test with a choice of tests builds what
# development/choose.py says.
function(_iotcloud_needed_by_tests)
  cmake_parse_arguments(arg "" "" "TARGETS;LABELS" ${ARGN})
  if(NOT TARGET tested_all)
    add_custom_target(tested_all)
  endif()
  set(preset release)
  if(IOTCLOUD_SANITIZE MATCHES address)
    set(preset asan)
  elseif(IOTCLOUD_SANITIZE MATCHES thread)
    set(preset tsan)
  endif()
  if(arg_TARGETS AND preset IN_LIST arg_LABELS)
    add_dependencies(tested_all ${arg_TARGETS})
  endif()
endfunction()

# A GoogleTest program; each of its tests is a test of ctest.
#   LABELS: one of `unit`, `contract`, `server`, `system`, `long` (tests/README.md says what they mean), then `java` if
#   it starts servers from Maven Central, `ros` if it needs ROS, `browser` if it needs Chromium and packages of npm, `packages` if it
#   makes Debian packages or installs them, and `serverless` if it is no unit test and starts no server: ./dev test installs and
#   fetches what the labels of the chosen tests say. A server of tests/servers does not start for a test whose labels say that it needs none (its environment has IOTCLOUD_TEST_LABELS).
#   SANITIZERS: asan if it handles bytes or lifetimes of its own, tsan if it has threads. Both are the default of `unit` and
#   `contract`; `SANITIZERS none` turns them off. ./dev test runs the test under tsan, or else under asan, and nowhere else,
#   but for those that say OPTIMIZED, which run under all: they test what release compiles with -O3. With LATER it runs them
#   in release, and --long under the sanitizers: those of command lines and of all plugins, for which ./dev test would compile
#   much under the sanitizers that no other test needs.
#   WHOLE words: its tests share servers that take seconds to start, so ctest runs the program once for each word, with
#   the tests whose names contain the word. ctest starts the runs with the longest TIMEOUT first, so that none of them
#   is left to run alone at the end. A word that names Kafka or ActiveMQ adds the label `java`.
#   SHARDS words: each of these runs in two halves side by side, each with servers of its own.
#   LONG seconds: the program runs again in `long`, with IOTCLOUD_LONG=1 in its environment, for at most this time.
# A test whose server is unavailable here (tests/servers/private_server.h) exits with IOTCLOUD_TEST_SKIPPED.
function(iotcloud_test)
  set(skipped 77)
  cmake_parse_arguments(arg "OPTIMIZED;LATER" "NAME;TIMEOUT;LONG" "SOURCES;USES;LIBRARIES;LABELS;SANITIZERS;WHOLE;SHARDS" ${ARGN})
  set(when)
  foreach(word OPTIMIZED LATER)
    if(arg_${word})
      list(APPEND when ${word})
    endif()
  endforeach()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
  endif()
  if(NOT arg_SANITIZERS AND arg_LABELS MATCHES "^(unit|contract)")
    set(arg_SANITIZERS asan tsan)
  endif()
  list(REMOVE_ITEM arg_SANITIZERS none)
  _iotcloud_test_labels(labels LABELS ${arg_LABELS} SANITIZERS ${arg_SANITIZERS} ${when})
  add_executable(${arg_NAME} ${arg_SOURCES})
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES} GTest::gmock_main)
  _iotcloud_test_code(${arg_NAME})
  iotcloud_precompiled(${arg_NAME} tests)
  _iotcloud_unity(${arg_NAME} 8)
  _iotcloud_needed_by_tests(TARGETS ${arg_NAME} LABELS ${labels})
  # Test sources may include helpers as <iotcloud/tests/...>. The scripts that they run are in this folder:
  target_compile_definitions(${arg_NAME} PRIVATE IOTCLOUD_TEST_SERVERS="${PROJECT_SOURCE_DIR}/tests/servers"
                                                 IOTCLOUD_TEST_SKIPPED=${skipped})
  if(IOTCLOUD_SANITIZE MATCHES thread)
    target_sources(${arg_NAME} PRIVATE $<TARGET_OBJECTS:c11_threads_for_tsan>)
  endif()
  if(arg_WHOLE)
    foreach(word ${arg_WHOLE})
      _iotcloud_java_label(java ${word})
      set(own_labels ${labels} ${java})
      set(shards 0)
      if(word IN_LIST arg_SHARDS)
        set(shards 0 1)
      endif()
      list(LENGTH shards count)
      foreach(shard ${shards})
        set(test ${arg_NAME}.${word})
        if(count GREATER 1)
          string(APPEND test .${shard})
        endif()
        add_test(NAME ${test} COMMAND ${arg_NAME} --gtest_filter=*${word}*)
        list(JOIN own_labels "," told)
        set_tests_properties(${test} PROPERTIES TIMEOUT ${arg_TIMEOUT} LABELS "${own_labels}" COST ${arg_TIMEOUT}
          SKIP_RETURN_CODE ${skipped}
          ENVIRONMENT "GTEST_TOTAL_SHARDS=${count};GTEST_SHARD_INDEX=${shard};IOTCLOUD_TEST_LABELS=${told}")
        _iotcloud_list_test(NAME ${test} HOW test LABELS ${own_labels} TARGETS ${arg_NAME})
      endforeach()
    endforeach()
  else()
    _iotcloud_list_test(NAME ${arg_NAME} HOW program LABELS ${labels} TARGETS ${arg_NAME} SOURCES ${arg_SOURCES})
    list(JOIN labels "," told)
    # gtest_discover_tests() cannot pass on a list as a property's value, so the labels are set afterwards.
    gtest_discover_tests(${arg_NAME} TEST_LIST ${arg_NAME}_list DISCOVERY_TIMEOUT 60
                         PROPERTIES TIMEOUT ${arg_TIMEOUT} SKIP_RETURN_CODE ${skipped}
                                    ENVIRONMENT IOTCLOUD_TEST_LABELS=${told})
    set(script ${CMAKE_CURRENT_BINARY_DIR}/${arg_NAME}_labels.cmake)
    file(CONFIGURE OUTPUT ${script} CONTENT
"foreach(test IN LISTS @arg_NAME@_list)
  set_tests_properties(\${test} PROPERTIES LABELS \"@labels@\")
endforeach()
" @ONLY)
    set_property(DIRECTORY APPEND PROPERTY TEST_INCLUDE_FILES ${script})
  endif()
  if(arg_LONG)
    if(NOT arg_WHOLE)
      set(arg_WHOLE .)  # a dot is in every test's name
    endif()
    foreach(word ${arg_WHOLE})
      _iotcloud_java_label(java ${word})
      iotcloud_command_test(NAME ${arg_NAME}.long.${word} LABELS long ${java} TIMEOUT ${arg_LONG} NEEDS ${arg_NAME}
                            ENVIRONMENT IOTCLOUD_LONG=1 COMMAND ${arg_NAME} --gtest_filter=*${word}*)
    endforeach()
  endif()
endfunction()

# A test that runs a command, mostly a Python script.
#   iotcloud_command_test(NAME name COMMAND words... LABELS unit [NEEDS targets] [TIMEOUT 300] [COST 10] [ENVIRONMENT A=b]
#                         [MISSING what])
# With MISSING, and a text after it, the test is left out. A system test has twice the time without a TIMEOUT.
function(iotcloud_command_test)
  cmake_parse_arguments(arg "" "NAME;TIMEOUT;COST;WORKING_DIRECTORY;MISSING" "COMMAND;LABELS;NEEDS;ENVIRONMENT" ${ARGN})
  if(arg_MISSING)
    iotcloud_left_out(NAME ${arg_NAME} MISSING ${arg_MISSING} LABELS ${arg_LABELS})
    return()
  endif()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
    if(arg_LABELS MATCHES "^system")  # many programs, one after the other
      set(arg_TIMEOUT 600)
    endif()
  endif()
  _iotcloud_test_labels(labels LABELS ${arg_LABELS})
  list(JOIN labels "," told)
  list(APPEND arg_ENVIRONMENT IOTCLOUD_TEST_LABELS=${told})
  add_test(NAME ${arg_NAME} COMMAND ${arg_COMMAND} WORKING_DIRECTORY ${arg_WORKING_DIRECTORY})
  set_tests_properties(${arg_NAME} PROPERTIES TIMEOUT ${arg_TIMEOUT} LABELS "${labels}" SKIP_RETURN_CODE 77
                                              ENVIRONMENT "${arg_ENVIRONMENT}")
  _iotcloud_list_test(NAME ${arg_NAME} HOW test LABELS ${labels} TARGETS ${arg_NEEDS})
  if(NOT arg_COST AND labels MATCHES "^system;")
    set(arg_COST 200)  # these take long, so ctest starts them early, and none of them is left to run alone at the end
  endif()
  if(arg_COST)
    set_tests_properties(${arg_NAME} PROPERTIES COST ${arg_COST})
  endif()
  _iotcloud_needed_by_tests(TARGETS ${arg_NEEDS} LABELS ${labels})
endfunction()

# A fuzz target, whose source is <name>_fuzzer.cc. With the preset `fuzz` it is a libFuzzer program, and the target
# `fuzzers` builds them all. Otherwise its parts are added to IOTCLOUD_FUZZ_SOURCES, _USES and _LIBRARIES, those of THREADED
# targets, which talk to a service with threads, to IOTCLOUD_THREADED_FUZZ_SOURCES and so on; its name is added to IOTCLOUD_FUZZ_NAMES.
#   iotcloud_fuzzer(NAME envelope [THREADED] USES brokers)
function(iotcloud_fuzzer)
  cmake_parse_arguments(arg "THREADED" "NAME" "USES;LIBRARIES" ${ARGN})
  set(program ${arg_NAME}_fuzzer)
  set(arg_SOURCES ${program}.cc)
  if(NOT IOTCLOUD_SANITIZE MATCHES fuzzer)
    set(test IOTCLOUD_FUZZ)
    if(arg_THREADED)
      set(test IOTCLOUD_THREADED_FUZZ)
    endif()
    foreach(what SOURCES USES LIBRARIES)
      set(all ${${test}_${what}} ${arg_${what}})
      list(REMOVE_DUPLICATES all)
      set(${test}_${what} ${all} PARENT_SCOPE)
    endforeach()
    set(IOTCLOUD_FUZZ_NAMES "${IOTCLOUD_FUZZ_NAMES} ${arg_NAME}" PARENT_SCOPE)
    return()
  endif()
  add_executable(${program} ${arg_SOURCES})
  _iotcloud_setup(${program} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES})
  target_compile_definitions(${program} PRIVATE IOTCLOUD_LIBFUZZER)
  target_link_options(${program} PRIVATE -fsanitize=fuzzer)
  add_dependencies(fuzzers ${program})
endfunction()
