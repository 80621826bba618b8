// Names shared by the graphs (job_graphs.h) and the functions that run them (task_kinds.h). They are
// stored in databases: frozen.
#pragma once

namespace rg::jobs {

inline constexpr char kKindTrajectories[] = "trajectories";
inline constexpr char kKindTrain[] = "train";
inline constexpr char kKindAggregate[] = "aggregate";
inline constexpr char kKindExamine[] = "examine";
inline constexpr char kKindRollout[] = "rollout";
inline constexpr char kKindIdentify[] = "identify";
inline constexpr char kKindConclude[] = "conclude";
inline constexpr char kKindDiagnose[] = "diagnose";
inline constexpr char kKindFit[] = "fit";
inline constexpr char kKindAdopt[] = "adopt";
inline constexpr char kKindNothing[] = "nothing";  // what a task costs by itself: `bench service`

inline constexpr char kStageTrajectories[] = "trajectories";
inline constexpr char kStagePolicy[] = "policy";
inline constexpr char kStageAggregate[] = "aggregation";
inline constexpr char kStageExamine[] = "examination";
inline constexpr char kStageRollout[] = "rollout";
inline constexpr char kStageIdentify[] = "identification";
inline constexpr char kStageConclude[] = "conclusion";
inline constexpr char kStageDiagnose[] = "diagnosis";
inline constexpr char kStageRefine[] = "refinement";
inline constexpr char kStageAdopt[] = "adoption";

inline constexpr char kInputModel[] = "model";
inline constexpr char kInputShard[] = "shard";
inline constexpr char kInputPolicy[] = "policy";
inline constexpr char kInputMotion[] = "motion";
inline constexpr char kInputExamination[] = "examination";
inline constexpr char kInputRecording[] = "recording";
inline constexpr char kInputChain[] = "chain";
inline constexpr char kInputOthers[] = "others";
inline constexpr char kInputNominal[] = "nominal";
inline constexpr char kInputIdentifiedBefore[] = "identified_before";
inline constexpr char kInputIdentified[] = "identified";
inline constexpr char kInputDiagnosed[] = "diagnosed";
inline constexpr char kInputDiagnosedBefore[] = "diagnosed_before";
inline constexpr char kInputDiagnosis[] = "diagnosis";
inline constexpr char kInputResult[] = "result";
inline constexpr char kInputFitBatch[] = "batch";

inline constexpr char kOutputShard[] = "shard";
inline constexpr char kOutputPolicy[] = "policy";
inline constexpr char kOutputExamination[] = "examination";
inline constexpr char kOutputRecording[] = "recording";
inline constexpr char kOutputChain[] = "chain";
inline constexpr char kOutputModel[] = "model";
inline constexpr char kOutputParameters[] = "parameters";
inline constexpr char kOutputResult[] = "result";
inline constexpr char kOutputDiagnosis[] = "diagnosis";
inline constexpr char kOutputDiagnosed[] = "diagnosed";
inline constexpr char kOutputReport[] = "report";
inline constexpr char kOutputMotion[] = "motion";
inline constexpr char kOutputFit[] = "fit";

// Kinds of artefacts.
inline constexpr char kArtifactModel[] = "model";
inline constexpr char kArtifactShard[] = "trajectories";
inline constexpr char kArtifactPolicy[] = "policy";
inline constexpr char kArtifactExamination[] = "examination";
inline constexpr char kArtifactRecording[] = "recording";
inline constexpr char kArtifactMotion[] = "motion";
inline constexpr char kArtifactHopState[] = "hop-state";
inline constexpr char kArtifactParameters[] = "parameters";
inline constexpr char kArtifactResult[] = "iteration-result";
inline constexpr char kArtifactRecordingSet[] = "recording-set";
inline constexpr char kArtifactDiagnosis[] = "diagnosis";
inline constexpr char kArtifactReport[] = "report";
inline constexpr char kArtifactFitBatch[] = "fit-batch";
inline constexpr char kArtifactFit[] = "fit";

}  // namespace rg::jobs
