# Build conventions shared by every room: language level, warnings, and the helpers
# rg_library(), rg_executable(), rg_test() and rg_benchmark().

option(RG_TESTS "Build the tests" ON)
option(RG_FULL_TESTS "Build the tests that only deploy/check --full runs, too" ON)
option(RG_BENCHMARKS "Build the benchmarks under tests/benchmarks" ON)
option(RG_WERROR "Treat warnings as errors" ON)
option(RG_TOGETHER "Compile several sources as one where a target says so" ON)
option(RG_FUZZ "Build the libFuzzer programs of tests/fuzz (clang)" OFF)
set(RG_SANITIZE "" CACHE STRING "Sanitizers to build with, e.g. address,undefined")

set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/bin")
if(NOT CMAKE_BUILD_TYPE AND NOT CMAKE_CONFIGURATION_TYPES)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "" FORCE)
endif()

find_program(RG_CCACHE ccache)
if(RG_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  set(CMAKE_CXX_COMPILER_LAUNCHER "${RG_CCACHE}")
endif()

# Every unit is built for plain x86-64 with Eigen's alignment pinned, so that objects of units
# compiled for newer instruction sets (hot kernels only) have the same layout.
add_compile_definitions(EIGEN_MAX_ALIGN_BYTES=16)
add_compile_options(-Wall -Wextra -Wno-missing-field-initializers -fno-math-errno)
if(RG_WERROR)
  add_compile_options(-Werror)
endif()
if(RG_SANITIZE)
  add_compile_options(-fsanitize=${RG_SANITIZE} -fno-omit-frame-pointer -g)
  add_link_options(-fsanitize=${RG_SANITIZE})
endif()

# rg_compile_together(TARGET COUNT): COUNT sources of TARGET at a time are compiled as one, because what they
# include and the templates they share cost most of their time (docs/figures.md). Names in their anonymous
# namespaces must differ. Sources with COMPILE_OPTIONS or COMPILE_DEFINITIONS of their own stay apart.
function(rg_compile_together target count)
  if(RG_TOGETHER AND count GREATER 1)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE ${count})
    if(CMAKE_CXX_COMPILER_ID STREQUAL GNU)  # says of a source among others what is meant for headers
      target_compile_options(${target} PRIVATE -Wno-subobject-linkage)
    endif()
  endif()
endfunction()

# rg_library(NAME SOURCES a.cc … [DEPS …] [PRIVATE_DEPS …] [TOGETHER n])
# TOGETHER: how many sources are compiled as one, 1 unless said. Eight Eigen-heavy sources take up to a minute and
# 1.8 GB.
function(rg_library name)
  cmake_parse_arguments(A "" "TOGETHER" "SOURCES;DEPS;PRIVATE_DEPS" ${ARGN})
  if(A_SOURCES)
    add_library(${name} STATIC ${A_SOURCES})
    if(A_TOGETHER)
      rg_compile_together(${name} ${A_TOGETHER})
    endif()
    target_include_directories(${name} PUBLIC ${CMAKE_SOURCE_DIR})
    target_link_libraries(${name} PUBLIC ${A_DEPS} PRIVATE ${A_PRIVATE_DEPS})
  else()
    add_library(${name} INTERFACE)
    target_include_directories(${name} INTERFACE ${CMAKE_SOURCE_DIR})
    target_link_libraries(${name} INTERFACE ${A_DEPS})
  endif()
endfunction()

# rg_executable(NAME SOURCES … DEPS …)
function(rg_executable name)
  cmake_parse_arguments(A "" "" "SOURCES;DEPS" ${ARGN})
  add_executable(${name} ${A_SOURCES})
  target_include_directories(${name} PRIVATE ${CMAKE_SOURCE_DIR})
  target_link_libraries(${name} PRIVATE ${A_DEPS})
endfunction()

# Programs of the name in build/…/first/ that do without what `realitygrad run` does not need: deploy/quickstart
# builds them, target `first`, before the rest, target `programs`.
#   rg_first_program(NAME SOURCES … DEPS …)  the smaller program
#   rg_first_program(NAME SAME)              the program itself, by a link
add_custom_target(first)
add_custom_target(programs)
function(rg_first_program name)
  cmake_parse_arguments(A "SAME" "" "SOURCES;DEPS" ${ARGN})
  add_dependencies(programs ${name})
  if(A_SAME)
    file(MAKE_DIRECTORY "${CMAKE_BINARY_DIR}/first")
    file(CREATE_LINK "../bin/${name}" "${CMAKE_BINARY_DIR}/first/${name}" SYMBOLIC)
    add_dependencies(first ${name})
    return()
  endif()
  rg_executable(first-${name} SOURCES ${A_SOURCES} DEPS ${A_DEPS})
  set_target_properties(first-${name} PROPERTIES OUTPUT_NAME ${name}
    RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/first")
  add_dependencies(first first-${name})
endfunction()

# rg_test(NAME SOURCES … DEPS … [LABELS …] [TIMEOUT s] [COST s] [SHARDS n] [ENVIRONMENT …] [FULL]
#   [LONG pattern] [TOGETHER n])
# One ctest entry per GoogleTest program. FULL: only with `deploy/check --full` (label "full"). COST: about what it
# takes, for programs of more than ten seconds: ctest begins with the longest, so that no core is idle at the end.
# SHARDS: a long program is n entries of ctest, NAME_1 to NAME_n, each with its share of the tests; COST is of one.
# LONG: its tests of that pattern are an entry of their own, NAME_long, only with --full.
# TOGETHER: as for a library, 5 unless said.
function(rg_test name)
  if(NOT RG_TESTS)
    return()
  endif()
  cmake_parse_arguments(A "FULL" "TIMEOUT;COST;SHARDS;LONG;TOGETHER" "SOURCES;DEPS;LABELS;ENVIRONMENT" ${ARGN})
  rg_executable(${name} SOURCES ${A_SOURCES} DEPS ${A_DEPS} GTest::gtest GTest::gmock GTest::gtest_main)
  # What GoogleTest makes of a test is most of its code and runs once.
  if(CMAKE_BUILD_TYPE STREQUAL Release)
    target_compile_options(${name} PRIVATE -O1)
  endif()
  if(A_FULL AND NOT RG_FULL_TESTS)
    set_target_properties(${name} PROPERTIES EXCLUDE_FROM_ALL ON)
  endif()
  list(LENGTH A_SOURCES sources)
  if(NOT A_TOGETHER)
    set(A_TOGETHER 5)
  endif()
  if(sources GREATER 1)
    rg_compile_together(${name} ${A_TOGETHER})
  endif()
  if(NOT A_TIMEOUT)
    set(A_TIMEOUT 600)
  endif()
  if(A_FULL)
    list(APPEND A_LABELS full)
  endif()
  if(NOT A_SHARDS)
    set(A_SHARDS 1)
  endif()
  set(entries "")
  foreach(shard RANGE 1 ${A_SHARDS})
    set(entry ${name})
    set(share "")
    if(A_SHARDS GREATER 1)
      set(entry ${name}_${shard})
      math(EXPR index "${shard} - 1")
      set(share "GTEST_TOTAL_SHARDS=${A_SHARDS};GTEST_SHARD_INDEX=${index}")
    endif()
    if(A_LONG)
      list(APPEND share "GTEST_FILTER=-${A_LONG}")
    endif()
    list(APPEND entries ${entry})
    set(share_of_${entry} ${share})
  endforeach()
  if(A_LONG)
    list(APPEND entries ${name}_long)
    set(share_of_${name}_long "GTEST_FILTER=${A_LONG}")
  endif()
  foreach(entry ${entries})
    add_test(NAME ${entry} COMMAND ${name} WORKING_DIRECTORY ${CMAKE_SOURCE_DIR})
    set_tests_properties(${entry} PROPERTIES TIMEOUT ${A_TIMEOUT}
      ENVIRONMENT "RG_SOURCE_DIR=${CMAKE_SOURCE_DIR};RG_BIN_DIR=${CMAKE_BINARY_DIR}/bin;${A_ENVIRONMENT};${share_of_${entry}}"
      SKIP_REGULAR_EXPRESSION "\\[  SKIPPED \\].*ALL")
    if(A_COST)
      set_tests_properties(${entry} PROPERTIES COST ${A_COST})
    endif()
    if(A_LABELS)
      set_tests_properties(${entry} PROPERTIES LABELS "${A_LABELS}")
    endif()
  endforeach()
  if(A_LONG)
    set_property(TEST ${name}_long APPEND PROPERTY LABELS full)
  endif()
endfunction()

# rg_benchmark(NAME SOURCES … DEPS …): a Google Benchmark program, never part of ctest's verdict.
function(rg_benchmark name)
  if(NOT RG_BENCHMARKS)
    return()
  endif()
  find_package(benchmark REQUIRED)
  cmake_parse_arguments(A "" "" "SOURCES;DEPS" ${ARGN})
  rg_executable(${name} SOURCES ${A_SOURCES} DEPS ${A_DEPS} benchmark::benchmark)
endfunction()
